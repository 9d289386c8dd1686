//! The parts of an Open Job Description template that an exported shot uses. The specification is
//! <https://github.com/OpenJobDescription/openjd-specifications>, revision 2023-09. The templates use none of
//! its extensions, so that every farm that reads templates reads these.
//!
//! A template has *format strings*, in which `{{Param.Name}}` stands for a value. Two braces cannot be
//! escaped. So no name from a user is written into a format string: names and paths are defaults of
//! parameters, which are taken as they are.

use serde::Serialize;
use serde_json::Value;

/// Largest number of characters of a job's name, with its parameters resolved.
pub const LONGEST_JOB_NAME: usize = 128;
/// Largest number of characters of a parameter's value.
pub const LONGEST_VALUE: usize = 1024;
/// Largest integer that every reader of templates can hold.
pub const GREATEST_INTEGER: u64 = i64::MAX as u64;

/// A job: steps with one or many tasks each, and parameters that are set at submission.
#[derive(Debug, Serialize)]
#[serde(rename_all = "camelCase")]
pub struct JobTemplate {
    /// Revision of the specification.
    pub specification_version: &'static str,
    /// Name of the job, a format string.
    pub name: String,
    /// For people.
    pub description: String,
    /// Parameters that are set at submission.
    pub parameter_definitions: Vec<Parameter>,
    /// The steps. Each one follows those that it depends on.
    pub steps: Vec<Step>,
}

/// A parameter of the job.
#[derive(Debug, Serialize)]
#[serde(rename_all = "camelCase")]
pub struct Parameter {
    /// The name in `{{Param.…}}`.
    pub name: &'static str,
    /// What values it takes.
    #[serde(rename = "type")]
    pub kind: ParameterType,
    /// For people.
    pub description: &'static str,
    /// Whether a path leads to a file or a folder.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub object_type: Option<ObjectType>,
    /// Whether tasks read or write the file or folder.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub data_flow: Option<DataFlow>,
    /// Largest number of characters.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_length: Option<usize>,
    /// The allowed values. An empty list allows any value.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub allowed_values: Vec<Value>,
    /// The default. A parameter without one has to be set at submission.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub default: Option<Value>,
}

impl Parameter {
    /// A parameter without a default.
    pub fn new(name: &'static str, kind: ParameterType, description: &'static str) -> Self {
        let (object_type, data_flow, max_length) = (None, None, None);
        let (allowed_values, default) = (Vec::new(), None);
        Self { name, kind, description, object_type, data_flow, max_length, allowed_values, default }
    }

    /// The same with a default.
    pub fn default(self, value: impl Into<Value>) -> Self {
        Self { default: Some(value.into()), ..self }
    }

    /// The same, restricted to these values.
    pub fn one_of(self, values: impl IntoIterator<Item = impl Into<Value>>) -> Self {
        Self { allowed_values: values.into_iter().map(Into::into).collect(), ..self }
    }

    /// A path.
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

/// Kinds of values.
#[derive(Debug, Clone, Copy, Serialize)]
#[serde(rename_all = "UPPERCASE")]
pub enum ParameterType {
    /// A whole number.
    Int,
    /// A decimal number, kept as it is written.
    Float,
    /// Text.
    String,
    /// A path. A farm may map it to the path on its own machines.
    Path,
}

/// What a path leads to.
#[derive(Debug, Clone, Copy, Serialize)]
#[serde(rename_all = "UPPERCASE")]
pub enum ObjectType {
    /// A file.
    File,
    /// A folder.
    Directory,
}

/// What tasks do with a file or folder.
#[derive(Debug, Clone, Copy, Serialize)]
#[serde(rename_all = "UPPERCASE")]
pub enum DataFlow {
    /// They read it.
    In,
    /// They write it.
    Out,
    /// Some write what others read.
    InOut,
}

/// A step: one task, or one for each value of its parameter.
#[derive(Debug, Serialize)]
#[serde(rename_all = "camelCase")]
pub struct Step {
    /// Unique name.
    pub name: String,
    /// Steps that have to end before this one.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub dependencies: Vec<Dependency>,
    /// The tasks. `None` is one task.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub parameter_space: Option<ParameterSpace>,
    /// Requirements of the machine.
    pub host_requirements: HostRequirements,
    /// What a task does.
    pub script: Script,
}

/// A step that has to end before.
#[derive(Debug, Serialize)]
#[serde(rename_all = "camelCase")]
pub struct Dependency {
    /// Its name.
    pub depends_on: String,
}

/// The tasks of a step.
#[derive(Debug, Serialize)]
#[serde(rename_all = "camelCase")]
pub struct ParameterSpace {
    /// The parameter that differs between the tasks.
    pub task_parameter_definitions: [TaskParameter; 1],
}

/// A parameter with another value for every task.
#[derive(Debug, Serialize)]
pub struct TaskParameter {
    /// The name in `{{Task.Param.…}}`.
    pub name: &'static str,
    /// What values it takes.
    #[serde(rename = "type")]
    pub kind: ParameterType,
    /// The values, a range expression such as `0-47` or `0,5,9-12`, which may be a format string.
    pub range: String,
}

/// Requirements of the machine.
#[derive(Debug, Clone, Serialize)]
pub struct HostRequirements {
    /// Amounts, such as cores and memory.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub amounts: Vec<Amount>,
    /// Kinds, such as the operating system.
    pub attributes: Vec<Attribute>,
}

/// A required amount.
#[derive(Debug, Clone, Serialize)]
pub struct Amount {
    /// The specification's name of it.
    pub name: &'static str,
    /// The smallest amount that suffices. Memory is in MiB.
    pub min: u64,
}

/// A required kind.
#[derive(Debug, Clone, Serialize)]
#[serde(rename_all = "camelCase")]
pub struct Attribute {
    /// The specification's name of it.
    pub name: &'static str,
    /// The kinds that suffice.
    pub any_of: Vec<&'static str>,
}

/// What a task does.
#[derive(Debug, Serialize)]
pub struct Script {
    /// Its actions.
    pub actions: Actions,
}

/// The actions of a task.
#[derive(Debug, Serialize)]
#[serde(rename_all = "camelCase")]
pub struct Actions {
    /// The task itself.
    pub on_run: Action,
}

/// A program, run without a shell.
#[derive(Debug, Serialize)]
pub struct Action {
    /// The program, a format string.
    pub command: String,
    /// Its arguments, each a format string.
    pub args: Vec<String>,
    /// Time limit, seconds.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub timeout: Option<u64>,
    /// How the program is stopped.
    pub cancelation: Cancelation,
}

/// How a task is stopped: notified first, then killed.
#[derive(Debug, Serialize)]
#[serde(rename_all = "camelCase")]
pub struct Cancelation {
    /// The specification's name of this.
    pub mode: &'static str,
    /// Time between the notice and the kill.
    pub notify_period_in_seconds: u32,
}
