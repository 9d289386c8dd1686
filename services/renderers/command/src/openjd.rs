//! Arguments from an Open Job Description template: the same file makes a job for other farms and a renderer
//! here. Specification: <https://github.com/OpenJobDescription/openjd-specifications>, revision 2023-09.
//!
//! A step with one task parameter, the frame, is used. Its command, arguments, embedded files and variables
//! become templates of the command file: parameters that the file sets are replaced by what it says, all
//! others by their defaults.

use crate::template::Template;
use forelight_renderer::door::RendererError;
use serde::Deserialize;
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use toml::Spanned;

/// Revision of the specification.
const REVISION: &str = "jobtemplate-2023-09";

/// Placeholder of the folder in which the command runs.
pub(crate) const SESSION: &str = "openjd.session";

/// Beginning of the placeholders of embedded files.
pub(crate) const FILE: &str = "openjd.file.";

/// The extension for tasks of several frames.
const CHUNKING: &str = "TASK_CHUNKING";

/// Runs a file by its first line.
const ENV: &str = "/usr/bin/env";

/// The table of a command file.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct OpenJdTable {
    /// The job's template, YAML or JSON, from the file's folder on.
    template: PathBuf,
    /// Name of the step. `None`: the only one with task parameters.
    step: Option<String>,
    /// Values of the job's parameters.
    #[serde(default)]
    pub parameters: BTreeMap<String, Spanned<Template>>,
}

/// What a template gives to a command file.
pub(crate) struct OpenJdStep {
    pub arguments: Vec<Template>,
    pub environment: BTreeMap<String, Template>,
    pub files: Vec<EmbeddedFile>,
    /// First and last frame, and their distance.
    pub frames: Option<(i32, i32, u32)>,
    pub seconds: Option<u64>,
}

/// A file that is written before the command starts.
#[derive(Debug, Clone)]
pub(crate) struct EmbeddedFile {
    pub name: String,
    /// Name of the file.
    pub file: String,
    pub content: Template,
    pub is_runnable: bool,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct JobTemplate {
    specification_version: String,
    #[serde(default)]
    extensions: Vec<String>,
    #[serde(default)]
    parameter_definitions: Vec<JobParameter>,
    #[serde(default)]
    job_environments: Vec<Environment>,
    steps: Vec<Step>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct JobParameter {
    name: String,
    #[serde(rename = "type")]
    kind: String,
    default: Option<Value>,
    allowed_values: Option<Vec<Value>>,
    min_value: Option<Value>,
    max_value: Option<Value>,
    min_length: Option<usize>,
    max_length: Option<usize>,
}

impl JobParameter {
    /// Checks a value against the parameter's type, and against what the template allows.
    fn check(&self, value: &str) -> Result<(), String> {
        let Self { name, kind, .. } = self;
        let wrong = |reason: String| Err(format!("parameter {name} is {value:?}; {reason}"));
        let number = value.trim().parse::<f64>().ok().filter(|number| number.is_finite());
        let is_number = match kind.as_str() {
            "INT" if value.trim().parse::<i64>().is_err() => {
                return wrong("it is INT: a whole number".to_owned());
            }
            "FLOAT" if number.is_none() => return wrong("it is FLOAT: a number".to_owned()),
            kind => ["INT", "FLOAT"].contains(&kind),
        };
        let number = number.filter(|_| is_number);
        let bound = |bound: &Option<Value>| number.zip(text_of(bound.as_ref()?)?.trim().parse::<f64>().ok());
        if let Some((_, least)) = bound(&self.min_value).filter(|(number, least)| number < least) {
            return wrong(format!("its minValue is {least}"));
        }
        if let Some((_, most)) = bound(&self.max_value).filter(|(number, most)| number > most) {
            return wrong(format!("its maxValue is {most}"));
        }
        let length = value.chars().count();
        if let Some(least) = self.min_length.filter(|&least| length < least) {
            return wrong(format!("its minLength is {least}"));
        }
        if let Some(most) = self.max_length.filter(|&most| length > most) {
            return wrong(format!("its maxLength is {most}"));
        }
        if let Some(allowed) = &self.allowed_values {
            let allowed: Vec<String> = allowed.iter().filter_map(text_of).collect();
            let is_value = |text: &String| match number {
                Some(number) => text.trim().parse() == Ok(number),
                None => text == value,
            };
            if !allowed.iter().any(is_value) {
                return wrong(format!("its allowedValues are {}", allowed.join(", ")));
            }
        }
        Ok(())
    }
}

/// A string, number or truth value as text.
fn text_of(value: &Value) -> Option<String> {
    match value {
        Value::String(text) => Some(text.clone()),
        Value::Number(_) | Value::Bool(_) => Some(value.to_string()),
        _ => None,
    }
}

#[derive(Deserialize)]
struct Environment {
    name: String,
    #[serde(default)]
    variables: BTreeMap<String, String>,
    script: Option<Value>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Step {
    name: String,
    parameter_space: Option<ParameterSpace>,
    #[serde(default)]
    dependencies: Vec<Dependency>,
    #[serde(default)]
    step_environments: Vec<Environment>,
    script: Script,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Dependency {
    depends_on: String,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct ParameterSpace {
    task_parameter_definitions: Vec<TaskParameter>,
}

#[derive(Deserialize)]
struct TaskParameter {
    name: String,
    #[serde(rename = "type")]
    kind: String,
    range: Value,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Script {
    actions: Actions,
    #[serde(default)]
    embedded_files: Vec<Embedded>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Actions {
    on_run: Action,
}

#[derive(Deserialize)]
struct Action {
    command: String,
    #[serde(default)]
    args: Vec<String>,
    timeout: Option<Value>,
}

#[derive(Deserialize)]
struct Embedded {
    name: String,
    filename: Option<String>,
    data: String,
    #[serde(default)]
    runnable: bool,
}

impl OpenJdTable {
    /// Reads the step of the template. `folder` is that of the command file.
    ///
    /// # Errors
    /// If the template cannot be read, or has something that only a farm can do: names it.
    pub fn read(&self, folder: &Path) -> Result<OpenJdStep, RendererError> {
        let path = folder.join(&self.template);
        let text = std::fs::read_to_string(&path).map_err(RendererError::io(&path))?;
        let wrong = |reason: String| RendererError::Scene { scene: path.clone(), reason };
        let job: JobTemplate = yaml_serde::from_str(&text).map_err(|error| wrong(error.to_string()))?;
        let from = path.parent().unwrap_or(Path::new("/"));
        self.step_of(job, (folder, from)).map_err(wrong)
    }

    /// `folders`: of the command file, and of the template.
    fn step_of(&self, job: JobTemplate, folders: (&Path, &Path)) -> Result<OpenJdStep, String> {
        if job.specification_version != REVISION {
            return Err(format!(
                "specificationVersion is {}; {REVISION} is known",
                job.specification_version
            ));
        }
        if let Some(extension) = job.extensions.iter().find(|name| *name != CHUNKING) {
            return Err(format!("it needs the extension {extension}; only {CHUNKING} is known"));
        }
        if let Some(unknown) = self
            .parameters
            .keys()
            .find(|name| !job.parameter_definitions.iter().any(|parameter| parameter.name == **name))
        {
            return Err(format!("the job has no parameter {unknown}, which openjd.parameters sets"));
        }
        let mut names = Names { values: BTreeMap::new() };
        for parameter in &job.parameter_definitions {
            let value = self.value_of(parameter, folders)?;
            for kind in ["Param", "RawParam"] {
                names.values.insert(format!("{kind}.{}", parameter.name), value.clone());
            }
        }
        let (step, task) = self.choose(&job.steps)?;
        if let Some(Dependency { depends_on }) = step.dependencies.first() {
            return Err(format!(
                "step {} depends on {depends_on}, which only a farm runs before it",
                step.name
            ));
        }
        let range = frames_of(&task.range, &names)?;
        let frame = match task.kind.as_str() {
            "INT" => Template::placeholder("frame"),
            // A range of one frame.
            "CHUNK[INT]" => Template::joined([
                Template::placeholder("frame"),
                Template::text("-"),
                Template::placeholder("frame"),
            ]),
            kind => {
                return Err(format!("step {}: parameter {} is {kind}; frames are INT", step.name, task.name));
            }
        };
        for kind in ["Task.Param", "Task.RawParam"] {
            names.values.insert(format!("{kind}.{}", task.name), frame.clone());
        }
        names.values.insert("Session.WorkingDirectory".to_owned(), Template::placeholder(SESSION));
        for Embedded { name, .. } in &step.script.embedded_files {
            let place = Template::placeholder(&format!("{FILE}{name}"));
            names.values.insert(format!("Task.File.{name}"), place);
        }
        let mut environment = BTreeMap::new();
        for one in job.job_environments.iter().chain(&step.step_environments) {
            if one.script.is_some() {
                return Err(format!("environment {} has actions, which only a farm runs", one.name));
            }
            for (name, value) in &one.variables {
                environment.insert(name.clone(), names.fill(value)?);
            }
        }
        let Action { command, args, timeout } = &step.script.actions.on_run;
        let command = names.fill(command)?;
        let program = command.names().next().is_some().then(|| Template::text(ENV));
        let arguments = args.iter().map(|argument| names.fill(argument)).collect::<Result<Vec<_>, _>>()?;
        let files = step.script.embedded_files.iter().map(|file| names.embedded(file));
        Ok(OpenJdStep {
            arguments: program.into_iter().chain([command]).chain(arguments).collect(),
            environment,
            files: files.collect::<Result<_, _>>()?,
            frames: range,
            seconds: timeout.as_ref().map(|timeout| names.seconds(timeout)).transpose()?,
        })
    }

    /// The value of a job's parameter: what the file says, or its default.
    fn value_of(
        &self,
        parameter: &JobParameter,
        (own_folder, folder): (&Path, &Path),
    ) -> Result<Template, String> {
        let JobParameter { name, kind, default, .. } = parameter;
        if let Some(set) = self.parameters.get(name) {
            let set = set.get_ref().clone();
            // What placeholders stand for is known when a frame is rendered.
            if set.names().next().is_none() {
                parameter.check(&set.fill(&BTreeMap::new()))?;
            }
            // As all paths of a command file, it is from the file's folder on.
            return Ok(match kind == "PATH" && set.begins_relative() {
                true => Template::joined([Template::text(&format!("{}/", own_folder.display())), set]),
                false => set,
            });
        }
        let text = default
            .as_ref()
            .and_then(text_of)
            .ok_or_else(|| format!("parameter {name} has no default: set it in openjd.parameters"))?;
        parameter.check(&text)?;
        // An empty path is none.
        let is_path = kind == "PATH" && !text.is_empty();
        let text = if is_path { folder.join(&text).display().to_string() } else { text };
        Ok(Template::text(&text))
    }

    /// The step that renders, and its frame.
    fn choose<'a>(&self, steps: &'a [Step]) -> Result<(&'a Step, &'a TaskParameter), String> {
        let parameters = |step: &'a Step| -> &'a [TaskParameter] {
            step.parameter_space.as_ref().map_or(&[], |space| &space.task_parameter_definitions)
        };
        let chosen: Vec<&Step> = match &self.step {
            Some(name) => steps.iter().filter(|step| step.name == *name).collect(),
            None => steps.iter().filter(|step| !parameters(step).is_empty()).collect(),
        };
        let [step] = chosen[..] else {
            let names: Vec<&str> = steps.iter().map(|step| step.name.as_str()).collect();
            return Err(format!("name the step that renders frames in openjd.step: {}", names.join(", ")));
        };
        match parameters(step) {
            [frame] => Ok((step, frame)),
            all => {
                Err(format!("step {} has {} task parameters; it needs one, the frame", step.name, all.len()))
            }
        }
    }
}

/// Frames of a range expression such as `1-24` or `1-24:2`. `None` for others, such as lists.
fn frames_of(range: &Value, names: &Names) -> Result<Option<(i32, i32, u32)>, String> {
    let Value::String(text) = range else { return Ok(None) };
    let text = names.fill(text)?;
    if text.names().next().is_some() {
        return Ok(None);
    }
    let text = text.fill(&BTreeMap::new());
    let (ends, step) = text.split_once(':').unwrap_or((&text, "1"));
    // The first frame may be below 0, so a hyphen at the beginning is a sign.
    let cut = ends.char_indices().skip(1).find(|&(_, c)| c == '-').map(|(at, _)| at);
    let (first, last) = cut.map_or((ends, ends), |at| (&ends[..at], &ends[at + 1..]));
    let number = |text: &str| text.trim().parse::<i32>().ok();
    Ok(number(first).zip(number(last)).zip(step.trim().parse().ok()).map(|((a, b), step)| (a, b, step)))
}

/// What names in format strings stand for.
struct Names {
    values: BTreeMap<String, Template>,
}

impl Names {
    /// A format string with its values.
    fn fill(&self, text: &str) -> Result<Template, String> {
        let mut pieces = Vec::new();
        let mut rest = text;
        while let Some((before, after)) = rest.split_once("{{") {
            let (name, after) =
                after.split_once("}}").ok_or_else(|| format!("`{{{{` without `}}}}` in {text:?}"))?;
            let name = name.trim();
            let value = self
                .values
                .get(name)
                .ok_or_else(|| format!("{{{{{name}}}}} is not known here, in {text:?}"))?;
            pieces.extend([Template::text(before), value.clone()]);
            rest = after;
        }
        pieces.push(Template::text(rest));
        Ok(Template::joined(pieces))
    }

    /// A time limit: a number, or a format string with one.
    fn seconds(&self, timeout: &Value) -> Result<u64, String> {
        let seconds = match timeout {
            Value::String(text) => self.fill(text)?.fill(&BTreeMap::new()).trim().parse().ok(),
            number => number.as_u64(),
        };
        seconds.ok_or_else(|| format!("timeout {timeout} is not a number of seconds"))
    }

    fn embedded(&self, embedded: &Embedded) -> Result<EmbeddedFile, String> {
        let Embedded { name, filename, data, runnable } = embedded;
        let file = filename.clone().unwrap_or_else(|| name.clone());
        if ["", ".", ".."].contains(&file.as_str()) || file.contains(['/', '\\', '=']) {
            return Err(format!("embedded file {name}: {file:?} is not the name of a file"));
        }
        Ok(EmbeddedFile { name: name.clone(), file, content: self.fill(data)?, is_runnable: *runnable })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frames(range: &str) -> Option<(i32, i32, u32)> {
        let names = Names { values: [("Param.Frames".to_owned(), Template::text("5-9:2"))].into() };
        frames_of(&Value::from(range), &names).unwrap()
    }

    #[test]
    fn ranges_of_frames_are_first_last_and_step() {
        assert_eq!(frames("1-24"), Some((1, 24, 1)));
        assert_eq!(frames("-3-4"), Some((-3, 4, 1)));
        assert_eq!(frames("7"), Some((7, 7, 1)));
        assert_eq!(frames("{{ Param.Frames }}"), Some((5, 9, 2)));
        assert_eq!(frames("1,4,9"), None);
    }

    #[test]
    fn parameters_have_values_that_the_template_allows() {
        let check = |definition: &str, value: &str| {
            let parameter: JobParameter = yaml_serde::from_str(definition).unwrap();
            parameter.check(value).err().unwrap_or_default()
        };
        let samples = "{name: Samples, type: INT, minValue: 1, maxValue: '64', allowedValues: [4, 16, 64]}";
        assert_eq!(check(samples, "16"), "");
        assert!(check(samples, "0").contains("its minValue is 1"));
        assert!(check(samples, "128").contains("its maxValue is 64"));
        assert_eq!(check(samples, "8"), "parameter Samples is \"8\"; its allowedValues are 4, 16, 64");
        assert!(check(samples, "many").contains("a whole number"));
        let scale = "{name: Scale, type: FLOAT, allowedValues: [0.5, 1.0]}";
        assert_eq!(check(scale, "1"), "", "numbers are compared as numbers");
        assert!(check(scale, "x").contains("a number"));
        let camera = "{name: Camera, type: STRING, minLength: 1, maxLength: 4, allowedValues: [left, '7']}";
        assert_eq!(check(camera, "left"), "");
        assert!(check(camera, "7.0").contains("its allowedValues are left, 7"), "text is compared as text");
        assert!(check(camera, "").contains("its minLength is 1"));
        assert!(check(camera, "right").contains("its maxLength is 4"));
    }

    #[test]
    fn braces_that_are_no_names_stay_as_they_are() {
        let names = Names { values: BTreeMap::new() };
        assert_eq!(names.fill("a {b} }} c").unwrap().fill(&BTreeMap::new()), "a {b} }} c");
        assert!(names.fill("{{Param.X}}").unwrap_err().contains("{{Param.X}} is not known"));
        assert!(names.fill("{{Param.X").unwrap_err().contains("without"));
    }
}
