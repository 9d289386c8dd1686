//! A shot as an Open Job Description job. One step renders, with one task per frame or range of frames.
//! Earlier steps plan, fill and merge the irradiance cache, if there is one.

use super::template::{
    Action, Actions, Amount, Attribute, CHUNKING, Cancelation, Chunks, DataFlow, Dependency,
    HostRequirements, JobTemplate, LONGEST_JOB_NAME, ObjectType, Parameter, ParameterSpace, ParameterType,
    Script, Step, TaskParameter, TaskParameterType,
};
use clap::ValueEnum;
use forelight_protocol::{
    CacheMode, FrameSet, Integrator, JobSettings, MaterialMode, RenderSettings, ShotSettings,
};
use forelight_terminal::options::PreviewBackend;
use serde_json::Value;
use std::collections::BTreeMap;

#[derive(Debug, Clone)]
pub struct ExportedShot {
    pub name: String,
    pub description: String,
    /// Path of the bundle from the template's folder. `None` if it has to be set at submission.
    pub bundle: Option<String>,
    pub bundle_is_folder: bool,
    pub frames: FrameSet,
    pub settings: JobSettings,
    /// Settings of another renderer that differ from the scene's.
    pub set: BTreeMap<String, Value>,
    /// Formats of images, the usual one first.
    pub formats: Vec<String>,
    /// Number of tasks that fill a level of the cache.
    pub cache_parts: u32,
    /// Threads of a task. `None` is one per core.
    pub threads: Option<u16>,
    /// How frames are divided into tasks. `None`: one for each frame.
    pub chunk: Option<Chunk>,
    /// Memory of a task, MiB, if it is known.
    pub memory_mib: Option<u64>,
    /// Time limits of tasks, seconds.
    pub frame_limit: Option<u64>,
    pub cache_limit: Option<u64>,
}

/// A task of several frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Chunk {
    /// Frames of a task, as long as the farm does not know how long they take.
    pub frames: u64,
    /// How long a task should take.
    pub seconds: u64,
}

/// A flag of `forelight render` and `forelight cache`, and the parameter that holds its value.
struct Flag {
    flag: &'static str,
    /// What is before the value, such as `denoise=`.
    before: String,
    parameter: Parameter,
}

impl Flag {
    fn new(flag: &'static str, parameter: Parameter) -> Self {
        Self { flag, before: String::new(), parameter }
    }
}

impl ExportedShot {
    pub fn template(&self) -> JobTemplate {
        JobTemplate {
            specification_version: "jobtemplate-2023-09",
            extensions: self.chunk.map(|_| CHUNKING).into_iter().collect(),
            name: of("JobName"),
            description: self.description.clone(),
            parameter_definitions: self.parameters(),
            steps: self.steps(),
        }
    }

    fn is_cached(&self) -> bool {
        self.settings.own().is_some_and(|settings| settings.cache == CacheMode::On)
    }

    fn parameters(&self) -> Vec<Parameter> {
        let bundle_type = if self.bundle_is_folder { ObjectType::Directory } else { ObjectType::File };
        let mut bundle = Parameter::path("Bundle", bundle_type, DataFlow::In, "Scene bundle");
        bundle.default = self.bundle.clone().map(Into::into);
        let mut name = Parameter::new("JobName", ParameterType::String, "Name of the job");
        name.max_length = Some(LONGEST_JOB_NAME);
        let frames = "Frames, such as 0-47 or 0,5,9-12";
        let program = "Name or path of the forelight program on the machines";
        let preview = "Device for ID previews: auto (the GPU if there is one), gpu, or cpu";
        let folder = |name, flow, what| Parameter::path(name, ObjectType::Directory, flow, what);
        let mut parameters = vec![
            name.default(self.name.clone()),
            Parameter::new("Forelight", ParameterType::String, program).default("forelight"),
            bundle,
            Parameter::new("Frames", ParameterType::String, frames).default(self.frames.to_string()),
            folder("Images", DataFlow::Out, "Folder of the images and their statistics").default("images"),
            Parameter::new("ImageFormat", ParameterType::String, "Format of the images")
                .default(self.formats.first().cloned().unwrap_or_default())
                .one_of(self.formats.iter().cloned()),
        ];
        if self.settings.own().is_some() {
            parameters.push(
                Parameter::new("Preview", ParameterType::String, preview)
                    .default("auto")
                    .one_of(names::<PreviewBackend>()),
            );
        }
        if let Some(chunk) = self.chunk {
            let frames = "Frames of the first tasks; later ones have as many as fit into ChunkSeconds";
            let whole =
                |name, what, value: u64| Parameter::new(name, ParameterType::Int, what).default(value);
            parameters.push(whole("ChunkFrames", frames, chunk.frames));
            parameters.push(whole("ChunkSeconds", "Time that a task should take, in seconds", chunk.seconds));
        }
        if self.is_cached() {
            let what = "Folder of the irradiance cache, which all machines must share";
            parameters.push(folder("CacheFolder", DataFlow::InOut, what).default("cache"));
        }
        parameters.extend(self.quality().into_iter().map(|quality| quality.parameter));
        parameters
    }

    /// The flags of quality. All are set, so that a version with other defaults renders the same images.
    fn quality(&self) -> Vec<Flag> {
        match &self.settings {
            JobSettings::Own(settings) => self.own_quality(settings),
            JobSettings::Shot(settings) => self.other_quality(settings),
        }
    }

    /// What all renderers have, and what was set of another renderer's own settings.
    fn other_quality(&self, settings: &ShotSettings) -> Vec<Flag> {
        let ShotSettings { width, height, samples, seed, .. } = settings;
        let known = [
            ("--width", "Width", width, "Image width in pixels"),
            ("--height", "Height", height, "Image height in pixels"),
            ("--spp", "Spp", samples, "Samples per pixel"),
            ("--seed", "Seed", seed, "Seed of all random numbers"),
        ];
        let whole = known.into_iter().filter_map(|(flag, name, value, what)| {
            Some(Flag::new(flag, Parameter::new(name, ParameterType::Int, what).default((*value)?)))
        });
        // Names of parameters are short, and have letters, digits and `_` only.
        let set = (1..).zip(&self.set).map(|(number, (name, value))| {
            let plain = name.chars().filter(|c| c.is_ascii_alphanumeric() || *c == '_').take(40);
            let parameter = format!("Set{number}_{}", plain.collect::<String>());
            let what = "A setting of the renderer, as JSON";
            let parameter = Parameter::new(parameter, ParameterType::String, what).default(value.to_string());
            Flag { flag: "--set", before: format!("{name}="), parameter }
        });
        whole.chain(set).collect()
    }

    fn own_quality(&self, settings: &RenderSettings) -> Vec<Flag> {
        let whole = |flag, name: &'static str, value: u32, what: &'static str| {
            Flag::new(flag, Parameter::new(name, ParameterType::Int, what).default(value))
        };
        let one_of =
            |flag, name: &'static str, value: &'static str, values: Vec<String>, what: &'static str| {
                let parameter = Parameter::new(name, ParameterType::String, what);
                Flag::new(flag, parameter.default(value).one_of(values))
            };
        let integrator = settings.integrator.name();
        let materials = settings.materials.name();
        let mut bounces = whole(
            "--ambient-bounces",
            "AmbientBounces",
            settings.ambient_bounces,
            "Diffuse bounces of indirect light",
        );
        if self.is_cached() && self.cache_parts > 1 {
            // The number of steps depends on the levels of the cache.
            bounces.parameter = bounces.parameter.one_of([settings.ambient_bounces]);
        }
        let seed = Parameter::new("Seed", ParameterType::Int, "Seed of all random numbers");
        // Only `ambient` reads a cache.
        let integrators = if self.is_cached() { vec![integrator.to_owned()] } else { names::<Integrator>() };
        let mut flags = vec![
            whole("--width", "Width", settings.width, "Image width in pixels"),
            whole("--height", "Height", settings.height, "Image height in pixels"),
            whole("--spp", "Spp", settings.spp, "Camera samples per pixel"),
            one_of("--integrator", "Integrator", integrator, integrators, "Integrator: ambient or path"),
            bounces,
            whole(
                "--ambient-divisions",
                "AmbientDivisions",
                settings.ambient_divisions,
                "Rays of one indirect gather",
            ),
            whole("--max-depth", "MaxDepth", settings.max_depth, "Longest chain of mirror and glass hits"),
            one_of(
                "--materials",
                "Materials",
                materials,
                names::<MaterialMode>(),
                "The scene's materials (full), or every surface diffuse (lambert)",
            ),
            Flag::new("--seed", seed.default(settings.seed)),
        ];
        if self.is_cached() {
            let accuracy = "Error of the irradiance cache, 0.01 to 1";
            let parameter = Parameter::new("CacheAccuracy", ParameterType::Float, accuracy);
            let value = (f64::from(settings.cache_accuracy) / 1000.0).to_string();
            flags.push(Flag::new("--cache-accuracy", parameter.default(value)));
            flags.push(whole(
                "--cache-rays",
                "CacheRays",
                settings.cache_rays,
                "Rays of each record of the irradiance cache",
            ));
        }
        flags
    }

    fn steps(&self) -> Vec<Step> {
        let mut steps = if self.is_cached() { self.cache_steps() } else { Vec::new() };
        let (flag, name) = match self.chunk {
            None => ("--frame", of_task("Frame")),
            Some(_) => ("--frames", "#".to_owned()),
        };
        let image = format!("{}/{name}", of("Images"));
        let mut args = strings(["render", &of("Bundle"), flag, &of_task("Frame")]);
        if self.is_cached() {
            args.extend(["--cache-file".to_owned(), cache_file("shot")]);
        }
        args.extend(["--out".to_owned(), format!("{image}.{}", of("ImageFormat"))]);
        args.extend(["--stats".to_owned(), format!("{image}.json")]);
        args.extend(self.how());
        let mut space = tasks("Frame", of("Frames"));
        if self.chunk.is_some() {
            let [frame] = &mut space.task_parameter_definitions;
            frame.kind = TaskParameterType::Chunk;
            frame.chunks = Some(Chunks {
                default_task_count: of("ChunkFrames"),
                target_runtime_seconds: of("ChunkSeconds"),
                range_constraint: "CONTIGUOUS",
            });
        }
        let space = Some(space);
        steps.push(self.step("Render", steps.last(), space, args, self.frame_limit));
        steps
    }

    /// The steps that make the shot's cache. With parts, many tasks fill a level, and a step merges them
    /// before the next level reads them.
    fn cache_steps(&self) -> Vec<Step> {
        let mut args = strings(["cache", "plan", &of("Bundle"), "--frames", &of("Frames")]);
        args.extend(["--out".to_owned(), cache_file("plan")]);
        args.extend(self.how());
        let mut steps = vec![self.step("PlanCache", None, None, args, self.cache_limit)];
        let fill = |from: &str, flags: Vec<String>| {
            let from = ["--cache-file".to_owned(), cache_file(from)];
            let args = strings(["cache", "fill", &of("Bundle")]).into_iter().chain(from).chain(flags);
            args.chain(self.how()).collect::<Vec<_>>()
        };
        if self.cache_parts == 1 {
            let args = fill("plan", vec!["--out".to_owned(), cache_file("shot")]);
            steps.push(self.step("FillCache", steps.last(), None, args, self.cache_limit));
            return steps;
        }
        let mut from = "plan".to_owned();
        let levels = self.settings.own().map_or(0, |settings| settings.ambient_bounces);
        for level in (1..=levels).rev() {
            let part = |part: &str| cache_file(&format!("level-{level}-part-{part}"));
            let filled = if level == 1 { "shot".to_owned() } else { format!("level-{level}") };
            let which = format!("{}/{}", of_task("Part"), self.cache_parts);
            let flags = vec!["--part".to_owned(), which, "--out".to_owned(), part(&of_task("Part"))];
            let space = Some(tasks("Part", format!("1-{}", self.cache_parts)));
            let name = format!("FillCacheLevel{level}");
            steps.push(self.step(&name, steps.last(), space, fill(&from, flags), self.cache_limit));

            let mut args = strings(["cache", "merge"]);
            args.extend((1..=self.cache_parts).map(|number| part(&number.to_string())));
            args.extend(["--out".to_owned(), cache_file(&filled)]);
            let name = format!("MergeCacheLevel{level}");
            steps.push(self.step(&name, steps.last(), None, args, self.cache_limit));
            from = filled;
        }
        steps
    }

    fn how(&self) -> Vec<String> {
        let quality = self.quality().into_iter();
        let mut flags: Vec<String> =
            quality.flat_map(|one| [one.flag.to_owned(), one.before + &of(&one.parameter.name)]).collect();
        if self.is_cached() {
            flags.extend(strings(["--cache", "on"]));
        }
        if self.settings.own().is_some() {
            flags.extend(["--preview".to_owned(), of("Preview")]);
        }
        if let Some(threads) = self.threads {
            flags.extend(["--threads".to_owned(), threads.to_string()]);
        }
        flags
    }

    fn step(
        &self,
        name: &str,
        after: Option<&Step>,
        parameter_space: Option<ParameterSpace>,
        args: Vec<String>,
        timeout: Option<u64>,
    ) -> Step {
        let cores = self.threads.map(|threads| Amount { name: "amount.worker.vcpu", min: threads.into() });
        let memory = self.memory_mib.map(|min| Amount { name: "amount.worker.memory", min });
        // On a notice, the program ends at once and leaves no incomplete files.
        let cancelation = Cancelation { mode: "NOTIFY_THEN_TERMINATE", notify_period_in_seconds: 30 };
        Step {
            name: name.to_owned(),
            dependencies: after
                .map(|step| Dependency { depends_on: step.name.clone() })
                .into_iter()
                .collect(),
            parameter_space,
            host_requirements: HostRequirements {
                amounts: cores.into_iter().chain(memory).collect(),
                attributes: vec![Attribute { name: "attr.worker.os.family", any_of: vec!["linux"] }],
            },
            script: Script {
                actions: Actions { on_run: Action { command: of("Forelight"), args, timeout, cancelation } },
            },
        }
    }
}

fn of(parameter: &str) -> String {
    format!("{{{{Param.{parameter}}}}}")
}

fn of_task(parameter: &str) -> String {
    format!("{{{{Task.Param.{parameter}}}}}")
}

fn cache_file(name: &str) -> String {
    format!("{}/{name}.cache", of("CacheFolder"))
}

fn tasks(name: &'static str, range: String) -> ParameterSpace {
    let kind = TaskParameterType::Int;
    ParameterSpace { task_parameter_definitions: [TaskParameter { name, kind, range, chunks: None }] }
}

fn strings<const COUNT: usize>(words: [&str; COUNT]) -> Vec<String> {
    words.map(str::to_owned).to_vec()
}

fn names<T: ValueEnum>() -> Vec<String> {
    let values = T::value_variants().iter().filter_map(ValueEnum::to_possible_value);
    values.map(|value| value.get_name().to_owned()).collect()
}

#[cfg(test)]
mod tests;
