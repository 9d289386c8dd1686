//! The parts of a job template of the Open Job Description specification (<https://github.com/OpenJobDescription/openjd-specifications>,
//! revision 2023-09) that an exported shot consists of. No extension of the specification is used: every farm that reads templates
//! reads these.
//!
//! A template knows *format strings*, in which `{{Param.Name}}` stands for a value and two braces cannot be escaped. So nothing that
//! a user named is written into one: names and paths are the defaults of parameters, which are taken as they are.

use serde::Serialize;
use serde_json::Value;

/// Most characters of a job's name, once its parameters are put in.
pub const LONGEST_JOB_NAME: usize = 128;
/// Most characters of a parameter's value.
pub const LONGEST_VALUE: usize = 1024;
/// Greatest integer of a parameter that every reader of templates can hold.
pub const GREATEST_INTEGER: u64 = i64::MAX as u64;

/// A job: steps, each of one or many tasks, over parameters that are set when the job is submitted.
#[derive(Debug, Serialize)]
#[serde(rename_all = "camelCase")]
pub struct JobTemplate {
    /// Revision of the specification.
    pub specification_version: &'static str,
    /// Name of the job, a format string.
    pub name: String,
    /// For people.
    pub description: String,
    /// What is set at submission.
    pub parameter_definitions: Vec<Parameter>,
    /// The steps, each after those that it depends on.
    pub steps: Vec<Step>,
}

/// A parameter of the job.
#[derive(Debug, Serialize)]
#[serde(rename_all = "camelCase")]
pub struct Parameter {
    /// What `{{Param.…}}` names it by.
    pub name: &'static str,
    /// What values it takes.
    #[serde(rename = "type")]
    pub kind: ParameterType,
    /// For people.
    pub description: &'static str,
    /// What a path leads to.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub object_type: Option<ObjectType>,
    /// Whether tasks read or write what a path leads to.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub data_flow: Option<DataFlow>,
    /// Most characters.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_length: Option<usize>,
    /// The values that there are; any if empty.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub allowed_values: Vec<Value>,
    /// What it is if nothing is said; without a default, something has to be.
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

    /// The same with these values alone.
    pub fn one_of(self, values: impl IntoIterator<Item = impl Into<Value>>) -> Self {
        Self { allowed_values: values.into_iter().map(Into::into).collect(), ..self }
    }

    /// A path, and what tasks do with what it leads to.
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
    /// A decimal number, which is kept as it is written.
    Float,
    /// Text.
    String,
    /// A path, which a farm may replace by where its own machines see the same.
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

/// What tasks do with what a path leads to.
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
    /// Name, of which there is but one.
    pub name: String,
    /// Steps that have to be done before.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub dependencies: Vec<Dependency>,
    /// The tasks; one if there is no space.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub parameter_space: Option<ParameterSpace>,
    /// What a machine has to have.
    pub host_requirements: HostRequirements,
    /// What a task does.
    pub script: Script,
}

/// A step that has to be done before.
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
    /// The one parameter that tells them apart.
    pub task_parameter_definitions: [TaskParameter; 1],
}

/// A parameter of which every task has another value.
#[derive(Debug, Serialize)]
pub struct TaskParameter {
    /// What `{{Task.Param.…}}` names it by.
    pub name: &'static str,
    /// What values it takes.
    #[serde(rename = "type")]
    pub kind: ParameterType,
    /// The values, a range expression such as `0-47` or `0,5,9-12`, which may be a format string.
    pub range: String,
}

/// What a machine has to have.
#[derive(Debug, Clone, Serialize)]
pub struct HostRequirements {
    /// Of what it needs how much.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub amounts: Vec<Amount>,
    /// Of what kind it is.
    pub attributes: Vec<Attribute>,
}

/// So much of something.
#[derive(Debug, Clone, Serialize)]
pub struct Amount {
    /// The specification's name of it.
    pub name: &'static str,
    /// At least; memory in MiB.
    pub min: u64,
}

/// A kind of machine.
#[derive(Debug, Clone, Serialize)]
#[serde(rename_all = "camelCase")]
pub struct Attribute {
    /// The specification's name of it.
    pub name: &'static str,
    /// What will do.
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

/// A program that is run, without a shell.
#[derive(Debug, Serialize)]
pub struct Action {
    /// The program, a format string.
    pub command: String,
    /// Its arguments, each a format string.
    pub args: Vec<String>,
    /// Seconds after which it is stopped.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub timeout: Option<u64>,
    /// How it is stopped.
    pub cancelation: Cancelation,
}

/// How a task is stopped: told to, and killed if it does not.
#[derive(Debug, Serialize)]
#[serde(rename_all = "camelCase")]
pub struct Cancelation {
    /// The specification's name of this.
    pub mode: &'static str,
    /// How long it is waited for.
    pub notify_period_in_seconds: u32,
}
