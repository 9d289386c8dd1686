//! The file that describes a renderer: its tables, and what is wrong with them.

use crate::openjd::{EmbeddedFile, FILE, OpenJdTable, SESSION};
use crate::template::Template;
use forelight_renderer::door::{Common, Frames, RendererError};
use forelight_renderer::process::Meaning;
use regex::Regex;
use serde::de::{self, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer};
use serde_json::{Map, Value, json};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use toml::Spanned;

/// Placeholders of a region, which `crop.text` may use.
const OF_CROP: [&str; 6] =
    ["crop_left", "crop_top", "crop_right", "crop_bottom", "crop_width", "crop_height"];

/// All other placeholders that every file has.
const OF_ALL: [&str; 11] = [
    "scene",
    "frame",
    "width",
    "height",
    "samples",
    "seed",
    "threads",
    "crop",
    "out",
    "out_folder",
    "folder",
];

/// A file as it is written.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct CommandFile {
    pub name: String,
    pub version: Option<String>,
    pub version_command: Option<Arguments<String>>,
    pub version_pattern: Option<Pattern>,
    /// From the file, or from the template that `openjd` names.
    #[serde(default)]
    pub arguments: Arguments<Spanned<Template>>,
    pub openjd: Option<OpenJdTable>,
    /// Files that are written before the command starts.
    #[serde(skip)]
    pub embedded: Vec<EmbeddedFile>,
    pub scene: PathBuf,
    pub output: Spanned<Template>,
    frames: Option<FramesTable>,
    /// Frames that the template has unless a job says otherwise.
    #[serde(skip)]
    frames_of_template: Option<FramesTable>,
    #[serde(default = "frames_per_second")]
    pub frames_per_second: f64,
    pub defaults: Defaults,
    #[serde(default)]
    pub can: BTreeSet<Can>,
    #[serde(default)]
    pub crop: CropFormat,
    #[serde(default)]
    pub environment: BTreeMap<String, Spanned<Template>>,
    #[serde(default)]
    pub pass_on: Vec<String>,
    #[serde(default)]
    pub network: bool,
    #[serde(default)]
    pub parameters: BTreeMap<String, Parameter>,
    pub progress: Option<Progress>,
    #[serde(default)]
    pub errors: Vec<KnownError>,
    #[serde(default)]
    pub limits: LimitsTable,
}

/// What a command can.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Can {
    Samples,
    Size,
    Crop,
}

/// A list of arguments.
#[derive(Debug, Clone)]
pub(crate) struct Arguments<T>(pub Vec<T>);

impl<T> Default for Arguments<T> {
    fn default() -> Self {
        Self(Vec::new())
    }
}

#[derive(Debug, Clone, Copy, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct FramesTable {
    first: i32,
    last: i32,
    #[serde(default = "one")]
    step: u32,
}

#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Defaults {
    width: u32,
    height: u32,
    #[serde(default = "one")]
    samples: u32,
    #[serde(default)]
    seed: u32,
}

/// How the command wants regions.
#[derive(Debug, Clone, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct CropFormat {
    /// What `{crop}` stands for.
    pub text: Option<Spanned<Template>>,
    /// Number of the first column and row: 0 or 1.
    #[serde(default)]
    pub first: u32,
    /// Whether right and bottom are the last pixels inside, not the first ones outside.
    #[serde(default)]
    pub inclusive: bool,
    /// Whether numbers are shares of width and height, not pixels.
    #[serde(default)]
    pub fractions: bool,
}

#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Parameter {
    #[serde(rename = "type")]
    kind: ParameterKind,
    default: Value,
    minimum: Option<f64>,
    maximum: Option<f64>,
    choices: Option<Vec<Value>>,
    description: Option<String>,
}

#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(rename_all = "snake_case")]
enum ParameterKind {
    Integer,
    Number,
    Boolean,
    String,
}

#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Progress {
    pub pattern: Pattern,
    pub unit: ProgressUnit,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum ProgressUnit {
    /// 0 to 1.
    Fraction,
    /// 0 to 100.
    Percent,
}

#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct KnownError {
    pub pattern: Pattern,
    means: MeansName,
}

#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(rename_all = "snake_case")]
enum MeansName {
    MissingFile,
    Licence,
    OutOfMemory,
    Gpu,
}

#[derive(Debug, Clone, Copy, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct LimitsTable {
    pub memory_mib: Option<u64>,
    pub seconds: Option<u64>,
}

/// A regular expression.
#[derive(Debug, Clone)]
pub(crate) struct Pattern(pub Regex);

fn one() -> u32 {
    1
}

fn frames_per_second() -> f64 {
    24.0
}

impl<'de, T: Deserialize<'de>> Deserialize<'de> for Arguments<T> {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        struct List<T>(std::marker::PhantomData<T>);
        impl<'de, T: Deserialize<'de>> Visitor<'de> for List<T> {
            type Value = Vec<T>;

            fn expecting(&self, to: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                to.write_str("a list with the program and its arguments, such as [\"render\", \"{scene}\"]")
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Vec<T>, A::Error> {
                let mut all = Vec::new();
                while let Some(one) = list.next_element()? {
                    all.push(one);
                }
                if all.is_empty() { Err(de::Error::invalid_length(0, &self)) } else { Ok(all) }
            }
        }
        from.deserialize_seq(List(std::marker::PhantomData)).map(Self)
    }
}

impl<'de> Deserialize<'de> for Pattern {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        let text = String::deserialize(from)?;
        // The crate draws a picture of the pattern. The last line is the reason.
        let reason =
            |e: regex::Error| e.to_string().lines().last().unwrap_or_default().replace("error: ", "");
        Regex::new(&text)
            .map(Self)
            .map_err(|e| de::Error::custom(format!("regular expression `{text}`: {}", reason(e))))
    }
}

impl CommandFile {
    /// Reads and checks a file.
    pub fn read(path: &Path) -> Result<Self, RendererError> {
        let text = std::fs::read_to_string(path).map_err(RendererError::io(path))?;
        let wrong = |(at, reason): (Option<usize>, String)| {
            let place = at.map_or_else(String::new, |at| place(&text, at));
            RendererError::Scene { scene: path.to_owned(), reason: format!("{place}{reason}") }
        };
        let mut file: Self = toml::from_str(&text).map_err(|e| wrong((start(&e), one_line(&e))))?;
        file.take_template(path.parent().unwrap_or(Path::new("/")))?;
        file.check().map_err(wrong)?;
        Ok(file)
    }

    /// Takes over what the Open Job Description template says, if the file names one.
    fn take_template(&mut self, folder: &Path) -> Result<(), RendererError> {
        let Some(table) = &self.openjd else { return Ok(()) };
        let step = table.read(folder)?;
        let placed = |template| Spanned::new(0..0, template);
        if self.arguments.0.is_empty() {
            self.arguments.0 = step.arguments.into_iter().map(placed).collect();
        }
        for (name, value) in step.environment {
            self.environment.entry(name).or_insert(placed(value));
        }
        self.embedded = step.files;
        self.frames_of_template = step.frames.map(|(first, last, step)| FramesTable { first, last, step });
        self.limits.seconds = self.limits.seconds.or(step.seconds);
        Ok(())
    }

    /// Frames of the shot.
    pub fn frames(&self) -> Frames {
        self.frames.or(self.frames_of_template).unwrap_or_default().frames()
    }

    /// Frames that its scene has, if the file itself says so.
    pub fn stated_frames(&self) -> Option<Frames> {
        self.frames.map(FramesTable::frames)
    }

    /// Whether a placeholder stands for any text that a job likes.
    pub fn is_free(&self, name: &str) -> bool {
        let parameter = self.parameters.get(name);
        parameter.is_some_and(|it| matches!(it.kind, ParameterKind::String) && it.choices.is_none())
    }

    /// Settings that all renderers have.
    pub fn common(&self) -> Common {
        let Defaults { width, height, samples, seed } = self.defaults;
        Common { width, height, samples, seed }
    }

    /// Values of all parameters where nothing else is asked for.
    pub fn own(&self) -> Map<String, Value> {
        self.parameters.iter().map(|(name, parameter)| (name.clone(), parameter.default.clone())).collect()
    }

    /// JSON schema of the parameters.
    pub fn schema(&self) -> Value {
        let properties: Map<String, Value> =
            self.parameters.iter().map(|(name, parameter)| (name.clone(), parameter.schema())).collect();
        json!({"type": "object", "additionalProperties": false, "properties": properties})
    }

    /// What serde does not see. The error is a place in the file, if known, and a reason.
    fn check(&self) -> Result<(), (Option<usize>, String)> {
        let error = |reason: String| Err((None, reason));
        if self.name.is_empty() {
            return error("name: it is empty".to_owned());
        }
        if self.version.is_some() == self.version_command.is_some() {
            return error("version: give either `version` or `version_command`".to_owned());
        }
        if self.version_pattern.as_ref().is_some_and(|pattern| pattern.groups() != 1) {
            return error(
                "version_pattern: it needs one group in parentheses, which is the version".to_owned(),
            );
        }
        if self.progress.as_ref().is_some_and(|progress| progress.pattern.groups() != 1) {
            return error(
                "progress.pattern: it needs one group in parentheses, which is the number".to_owned(),
            );
        }
        if self.arguments.0.is_empty() {
            return error("arguments: give `arguments`, or a template in `openjd`".to_owned());
        }
        match self.frames.or(self.frames_of_template) {
            None if self.openjd.is_some() => {
                let reason =
                    "frames: the frames of the template are no range such as 1-24: give `first` and `last`";
                return error(reason.to_owned());
            }
            None => return error("frames: give `first` and `last`".to_owned()),
            Some(frames) if frames.step == 0 || frames.first > frames.last => {
                return error("frames: `first` is at most `last`, and `step` at least 1".to_owned());
            }
            Some(_) => {}
        }
        if self.crop.first > 1 {
            return error("crop.first: the first column and row have the number 0 or 1".to_owned());
        }
        if let Some(name) =
            self.parameters.keys().find(|name| OF_ALL.contains(&&***name) || OF_CROP.contains(&&***name))
        {
            return error(format!("parameters.{name}: `{{{name}}}` is a placeholder already"));
        }
        self.check_placeholders()?;
        self.check_abilities()
    }

    fn check_placeholders(&self) -> Result<(), (Option<usize>, String)> {
        let own: Vec<&str> = self.parameters.keys().map(String::as_str).collect();
        let all = [&OF_ALL[..], &OF_CROP, &own].concat();
        let of_job = self.openjd.iter().flat_map(|table| table.parameters.values());
        let files: Vec<String> = self.embedded.iter().map(|file| format!("{FILE}{}", file.name)).collect();
        let of_template = self.openjd.iter().map(|_| SESSION).chain(files.iter().map(String::as_str));
        let with_files: Vec<&str> = all.iter().copied().chain(of_template).collect();
        let of_job = of_job.map(|one| (one, &all[..]));
        let templates = self.arguments.0.iter().chain(self.environment.values());
        let templates = of_job.chain(templates.map(|one| (one, &with_files[..])));
        let of_output = [&["frame"], &own[..]].concat();
        let output = std::iter::once((&self.output, &of_output[..]));
        let crop = self.crop.text.iter().map(|text| (text, &OF_CROP[..]));
        for (template, known) in templates.chain(output).chain(crop) {
            if let Some(unknown) = template.get_ref().names().find(|name| !known.contains(name)) {
                let known: Vec<String> = known.iter().map(|name| format!("{{{name}}}")).collect();
                let reason = format!("unknown placeholder `{{{unknown}}}`; known here: {}", known.join(" "));
                return Err((Some(template.span().start), reason));
            }
        }
        if self.arguments.0[0].get_ref().names().next().is_some() {
            let at = self.arguments.0[0].span().start;
            return Err((Some(at), "arguments: the program, which comes first, is a fixed text".to_owned()));
        }
        Ok(())
    }

    /// What the command can needs its placeholders, and no frame can be had without `{out}`.
    fn check_abilities(&self) -> Result<(), (Option<usize>, String)> {
        let used: BTreeSet<&str> = self
            .arguments
            .0
            .iter()
            .chain(self.environment.values())
            .map(Spanned::get_ref)
            .chain(self.embedded.iter().map(|file| &file.content))
            .flat_map(Template::names)
            .collect();
        let has = |names: &[&str]| names.iter().all(|name| used.contains(name));
        let places = [&OF_CROP[..4], &["crop_left", "crop_top", "crop_width", "crop_height"], &["crop"]];
        self.check_scripts()?;
        for (is_there, reason) in [
            (has(&["out"]) || has(&["out_folder"]), "arguments: no argument or parameter has `{out}`"),
            (
                !self.can.contains(&Can::Samples) || has(&["samples"]),
                "can: `samples` needs an argument with `{samples}`",
            ),
            (
                !self.can.contains(&Can::Size) || has(&["width", "height"]),
                "can: `size` needs arguments with `{width}` and `{height}`",
            ),
            (
                !self.can.contains(&Can::Crop) || places.iter().any(|names| has(names)),
                "can: `crop` needs an argument with `{crop}`, or with `{crop_left}` and its like",
            ),
        ] {
            if !is_there {
                return Err((None, reason.to_owned()));
            }
        }
        Ok(())
    }
}

impl FramesTable {
    fn frames(self) -> Frames {
        let Self { first, last, step } = self;
        Frames { first, last, step }
    }
}

impl Parameter {
    fn schema(&self) -> Value {
        let kind = match self.kind {
            ParameterKind::Integer => "integer",
            ParameterKind::Number => "number",
            ParameterKind::Boolean => "boolean",
            ParameterKind::String => "string",
        };
        let mut schema = json!({"type": kind, "default": self.default});
        for (name, value) in [("minimum", self.minimum), ("maximum", self.maximum)] {
            if let Some(value) = value {
                schema[name] = value.into();
            }
        }
        if let Some(choices) = &self.choices {
            schema["enum"] = choices.clone().into();
        }
        if let Some(description) = &self.description {
            schema["description"] = description.clone().into();
        }
        schema
    }
}

impl Pattern {
    /// Number of groups in parentheses.
    fn groups(&self) -> usize {
        self.0.captures_len() - 1
    }

    /// Text of the group, if the line has the pattern.
    pub fn find<'a>(&self, line: &'a str) -> Option<&'a str> {
        Some(self.0.captures(line)?.get(1)?.as_str())
    }
}

impl KnownError {
    /// What the message means.
    pub fn meaning(&self) -> Meaning {
        match self.means {
            MeansName::MissingFile => Meaning::MissingFile,
            MeansName::Licence => Meaning::Licence,
            MeansName::OutOfMemory => Meaning::OutOfMemory,
            MeansName::Gpu => Meaning::Gpu,
        }
    }
}

/// Where an error is. An error of the whole file has no place.
fn start(error: &toml::de::Error) -> Option<usize> {
    error.span().map(|span| span.start).filter(|&start| start > 0)
}

fn one_line(error: &toml::de::Error) -> String {
    error.message().split_whitespace().collect::<Vec<_>>().join(" ")
}

/// Line and column of a byte, counted from 1.
fn place(text: &str, at: usize) -> String {
    let before = &text[..text.floor_char_boundary(at)];
    let line = before.matches('\n').count() + 1;
    let column = before.rsplit('\n').next().unwrap_or_default().chars().count() + 1;
    format!("line {line}, column {column}: ")
}
