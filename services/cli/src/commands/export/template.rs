//! The parts of an Open Job Description template that a shot uses. Specification:
//! <https://github.com/OpenJobDescription/openjd-specifications>, revision 2023-09.
//!
//! In a *format string*, `{{Param.Name}}` stands for a value, and two braces cannot be escaped. So no name
//! from a user is in a format string. Names and paths are defaults of parameters, which are taken literally.

use serde::Serialize;
use serde_json::Value;
use std::borrow::Cow;

/// The extension for tasks of several values:
/// <https://github.com/OpenJobDescription/openjd-specifications/blob/mainline/rfcs/0001-task-chunking.md>.
pub const CHUNKING: &str = "TASK_CHUNKING";
/// Most values of a task. Some farms accept no more.
pub const LARGEST_CHUNK: u64 = 150;
/// Largest number of characters of a job's name, with its parameters resolved.
pub const LONGEST_JOB_NAME: usize = 128;
/// Largest number of characters of a parameter's value.
pub const LONGEST_VALUE: usize = 1024;
/// Largest integer that every reader of templates can hold.
pub const GREATEST_INTEGER: u64 = i64::MAX as u64;

#[derive(Debug, Serialize)]
#[serde(rename_all = "camelCase")]
pub struct JobTemplate {
    pub specification_version: &'static str,
    /// What a farm must know beyond the specification.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub extensions: Vec<&'static str>,
    /// A format string.
    pub name: String,
    pub description: String,
    pub parameter_definitions: Vec<Parameter>,
    /// Each step follows those that it depends on.
    pub steps: Vec<Step>,
}

#[derive(Debug, Serialize)]
#[serde(rename_all = "camelCase")]
pub struct Parameter {
    /// The name in `{{Param.…}}`.
    pub name: Cow<'static, str>,
    #[serde(rename = "type")]
    pub kind: ParameterType,
    pub description: &'static str,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub object_type: Option<ObjectType>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub data_flow: Option<DataFlow>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_length: Option<usize>,
    /// The allowed values. An empty list allows any value.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub allowed_values: Vec<Value>,
    /// A parameter without a default has to be set at submission.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub default: Option<Value>,
}

impl Parameter {
    pub fn new(name: impl Into<Cow<'static, str>>, kind: ParameterType, description: &'static str) -> Self {
        let name = name.into();
        let (object_type, data_flow, max_length) = (None, None, None);
        let (allowed_values, default) = (Vec::new(), None);
        Self { name, kind, description, object_type, data_flow, max_length, allowed_values, default }
    }

    pub fn default(self, value: impl Into<Value>) -> Self {
        Self { default: Some(value.into()), ..self }
    }

    pub fn one_of(self, values: impl IntoIterator<Item = impl Into<Value>>) -> Self {
        Self { allowed_values: values.into_iter().map(Into::into).collect(), ..self }
    }

    pub fn path(
        name: &'static str,
        object_type: ObjectType,
        flow: DataFlow,
        description: &'static str,
    ) -> Self {
        let parameter = Self::new(name, ParameterType::Path, description);
        Self { object_type: Some(object_type), data_flow: Some(flow), ..parameter }
    }
}

#[derive(Debug, Clone, Copy, Serialize)]
#[serde(rename_all = "UPPERCASE")]
pub enum ParameterType {
    Int,
    /// A decimal number, kept as it is written.
    Float,
    String,
    Path,
}

#[derive(Debug, Clone, Copy, Serialize)]
#[serde(rename_all = "UPPERCASE")]
pub enum ObjectType {
    File,
    Directory,
}

#[derive(Debug, Clone, Copy, Serialize)]
#[serde(rename_all = "UPPERCASE")]
pub enum DataFlow {
    In,
    Out,
    /// Some tasks write what others read.
    InOut,
}

/// A step: one task, or one for each value of its parameter.
#[derive(Debug, Serialize)]
#[serde(rename_all = "camelCase")]
pub struct Step {
    pub name: String,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub dependencies: Vec<Dependency>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub parameter_space: Option<ParameterSpace>,
    pub host_requirements: HostRequirements,
    pub script: Script,
}

#[derive(Debug, Serialize)]
#[serde(rename_all = "camelCase")]
pub struct Dependency {
    pub depends_on: String,
}

#[derive(Debug, Serialize)]
#[serde(rename_all = "camelCase")]
pub struct ParameterSpace {
    pub task_parameter_definitions: [TaskParameter; 1],
}

#[derive(Debug, Serialize)]
pub struct TaskParameter {
    /// The name in `{{Task.Param.…}}`.
    pub name: &'static str,
    #[serde(rename = "type")]
    pub kind: TaskParameterType,
    /// A range expression such as `0-47` or `0,5,9-12`, or a format string.
    pub range: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub chunks: Option<Chunks>,
}

#[derive(Debug, Serialize)]
pub enum TaskParameterType {
    /// One value for each task.
    #[serde(rename = "INT")]
    Int,
    /// A range of values for each task. Needs [`CHUNKING`].
    #[serde(rename = "CHUNK[INT]")]
    Chunk,
}

/// How the values of a parameter are divided into ranges.
#[derive(Debug, Serialize)]
#[serde(rename_all = "camelCase")]
pub struct Chunks {
    /// Values of a range, before the farm knows how long they take. A format string.
    pub default_task_count: String,
    /// How long a task should take. A format string.
    pub target_runtime_seconds: String,
    /// `CONTIGUOUS`: each range is written as `1-10`.
    pub range_constraint: &'static str,
}

#[derive(Debug, Clone, Serialize)]
pub struct HostRequirements {
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub amounts: Vec<Amount>,
    pub attributes: Vec<Attribute>,
}

/// A required amount, such as cores or memory.
#[derive(Debug, Clone, Serialize)]
pub struct Amount {
    pub name: &'static str,
    /// Memory is in MiB.
    pub min: u64,
}

/// A required property, such as the operating system.
#[derive(Debug, Clone, Serialize)]
#[serde(rename_all = "camelCase")]
pub struct Attribute {
    pub name: &'static str,
    pub any_of: Vec<&'static str>,
}

#[derive(Debug, Serialize)]
pub struct Script {
    pub actions: Actions,
}

#[derive(Debug, Serialize)]
#[serde(rename_all = "camelCase")]
pub struct Actions {
    pub on_run: Action,
}

/// A program, run without a shell.
#[derive(Debug, Serialize)]
pub struct Action {
    /// A format string.
    pub command: String,
    /// Format strings.
    pub args: Vec<String>,
    /// Seconds.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub timeout: Option<u64>,
    pub cancelation: Cancelation,
}

/// How a task is stopped: notified first, then killed.
#[derive(Debug, Serialize)]
#[serde(rename_all = "camelCase")]
pub struct Cancelation {
    pub mode: &'static str,
    pub notify_period_in_seconds: u32,
}
