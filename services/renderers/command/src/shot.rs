//! The four questions of the door, to a program that is started for each of them.

use crate::file::Can;
use crate::installation::CommandRenderer;
use crate::openjd::{EmbeddedFile, FILE, SESSION};
use crate::output::Listener;
use crate::scripts::{PLAIN, Script, is_plain};
use crate::template::Values;
use forelight_renderer::door::{
    Artefact, Capabilities, Common, Cost, Description, FixedCosts, FrameCounts, Frames, Limits, Measured,
    Part, PieceCost, PixelCount, PreviewBackend, Region, Rendered, Renderer as _, RendererError, Run,
    Settings, SettingsError, Shot, TakenOver,
};
use forelight_renderer::process::{Program, run};
use serde_json::Value;
use std::fs::File;
use std::io::Write as _;
use std::os::unix::fs::OpenOptionsExt as _;
use std::path::{Component, Path, PathBuf};
use std::time::{Duration, Instant};

/// A scene of a command.
pub(crate) struct CommandShot {
    renderer: CommandRenderer,
    scene: PathBuf,
    /// The only frames of the scene, if they are known.
    frames: Option<Frames>,
    description: Description,
}

/// What of a frame one start of the program renders.
#[derive(Clone, Copy)]
struct Piece<'a> {
    frame: i32,
    settings: &'a Settings,
    samples: u32,
    /// `None`: the whole image.
    region: Option<Region>,
}

impl CommandShot {
    pub fn new(
        renderer: CommandRenderer,
        scene: PathBuf,
        frames: Option<Frames>,
        description: Description,
    ) -> Self {
        Self { renderer, scene, frames, description }
    }

    fn can(&self, can: Can) -> bool {
        self.renderer.file.can.contains(&can)
    }

    /// Checks the settings. What the command cannot change has to be as its file says.
    fn check(&self, settings: &Settings) -> Result<(), RendererError> {
        settings.check(&self.renderer.settings_schema())?;
        let (asked, own) = (settings.common, self.description.settings.common);
        for (is_free, name, asked, own) in [
            (self.can(Can::Size), "width", asked.width, own.width),
            (self.can(Can::Size), "height", asked.height, own.height),
            (self.can(Can::Samples), "samples", asked.samples, own.samples),
        ] {
            if !is_free && asked != own {
                let reason = format!("{} always renders with {own}", self.renderer.id().name);
                return Err(SettingsError { path: format!("/{name}"), reason }.into());
            }
        }
        Ok(())
    }

    /// Checks that the shot has a frame.
    fn check_frame(&self, frame: i32) -> Result<(), RendererError> {
        match self.frames.filter(|frames| !frames.contains(frame)) {
            Some(frames) => {
                let reason = format!("frame {frame} is outside of the shot, which has frames {frames}");
                Err(RendererError::Unsupported(reason))
            }
            None => Ok(()),
        }
    }

    /// Starts the program once. The image is written to `out`.
    fn start(&self, piece: &Piece<'_>, out: &Path, run_: &Run<'_>) -> Result<Cost, RendererError> {
        let file = &self.renderer.file;
        // Its home, and its folder for temporary files.
        let home = tempfile::Builder::new().prefix("command-").tempdir_in(run_.scratch);
        let home = home.map_err(RendererError::io(run_.scratch))?;
        let limits = limits(run_.limits, file.limits.memory_mib, file.limits.seconds);
        let mut values = self.values(piece, out, limits.threads);
        self.embed(home.path(), &mut values)?;
        let mut program = Program::new(&self.renderer.program, home.path())
            .args(file.arguments.0[1..].iter().map(|argument| argument.get_ref().fill(&values)));
        if file.network {
            program = program.connected();
        }
        for name in &file.pass_on {
            program = program.pass_on(name);
        }
        for (name, value) in &file.environment {
            program = program.env(name, value.get_ref().fill(&values));
        }
        if out.exists() {
            std::fs::remove_file(out).map_err(RendererError::io(out))?;
        }
        let mut listener = Listener::new(file);
        let since = Instant::now();
        let ended = run(&program, &[], &Run { limits, ..*run_ }, &mut |line| listener.hear(&line.text, run_));
        let finished = ended.map_err(|error| listener.explain(error))?;
        if !out.is_file() {
            let name = program.name();
            let reason = format!("{name} ended without an error, and did not write {}", out.display());
            return Err(listener.explain(RendererError::Failed(reason)));
        }
        Ok(Cost {
            cpu_nanos: finished.usage.cpu_nanos,
            wall_nanos: nanos(since.elapsed()),
            peak_memory_bytes: finished.usage.peak_memory_bytes,
            counters: Default::default(),
        })
    }

    /// Writes the embedded files, and adds their paths and that of their folder.
    fn embed(&self, home: &Path, values: &mut Values) -> Result<(), RendererError> {
        let files = &self.renderer.file.embedded;
        values.insert(SESSION.to_owned(), home.display().to_string());
        let place = |file: &EmbeddedFile| home.join(&file.file);
        for file in files {
            values.insert(format!("{FILE}{}", file.name), place(file).display().to_string());
        }
        // A script would run what it takes for more than a path.
        let takes_scene = |script: &Script<'_>| script.text.names().any(|name| name == "scene");
        if let Some(Script { name, .. }) = self.renderer.file.scripts().into_iter().find(takes_scene)
            && !is_plain(&self.scene.to_string_lossy())
        {
            return self.unsupported(&format!(
                "takes the path of the scene into {name}: the path may have ASCII letters, digits and {PLAIN} only"
            ));
        }
        for file in files {
            let path = place(file);
            let mode = if file.is_runnable { 0o700 } else { 0o600 };
            let written = File::options().write(true).create_new(true).mode(mode).open(&path);
            let written = written.and_then(|mut to| to.write_all(file.content.fill(values).as_bytes()));
            written.map_err(RendererError::io(&path))?;
        }
        Ok(())
    }

    fn values(&self, piece: &Piece<'_>, out: &Path, threads: u32) -> Values {
        let Common { width, height, seed, .. } = piece.settings.common;
        let folder = out.parent().unwrap_or(Path::new("/"));
        let mut values: Values = [
            ("scene", self.scene.display().to_string()),
            ("folder", self.renderer.folder().display().to_string()),
            ("out", out.display().to_string()),
            ("out_folder", folder.display().to_string()),
            ("frame", piece.frame.to_string()),
            ("width", width.to_string()),
            ("height", height.to_string()),
            ("samples", piece.samples.to_string()),
            ("seed", seed.to_string()),
            ("threads", threads.to_string()),
        ]
        .map(|(name, value)| (name.to_owned(), value))
        .into();
        for (name, value) in self.description.settings.own.iter().chain(&piece.settings.own) {
            values.insert(name.clone(), plain(value));
        }
        let region = piece.region.unwrap_or(Region { x: 0, y: 0, width, height });
        self.add_region(&mut values, region, (width, height));
        values
    }

    /// Adds the region, in the numbers that the command wants.
    fn add_region(&self, values: &mut Values, region: Region, (width, height): (u32, u32)) {
        let format = &self.renderer.file.crop;
        let last = |start: u32, length: u32| start + format.first + length - u32::from(format.inclusive);
        let number = |pixels: u32, all: u32| {
            if format.fractions {
                (f64::from(pixels) / f64::from(all)).to_string()
            } else {
                pixels.to_string()
            }
        };
        for (name, pixels, all) in [
            ("crop_left", region.x + format.first, width),
            ("crop_top", region.y + format.first, height),
            ("crop_right", last(region.x, region.width), width),
            ("crop_bottom", last(region.y, region.height), height),
            ("crop_width", region.width, width),
            ("crop_height", region.height, height),
        ] {
            values.insert(name.to_owned(), number(pixels, all));
        }
        let names = ["crop_left", "crop_top", "crop_right", "crop_bottom"];
        let text = match &format.text {
            Some(text) => text.get_ref().fill(values),
            None => names.map(|name| values[name].as_str()).join(","),
        };
        values.insert("crop".to_owned(), text);
    }

    /// Renders pieces one by one, and removes their images.
    fn measure_pieces(&self, pieces: &[Piece<'_>], run: &Run<'_>) -> Result<Vec<Cost>, RendererError> {
        let folder = tempfile::tempdir_in(run.scratch).map_err(RendererError::io(run.scratch))?;
        let mut costs = Vec::with_capacity(pieces.len());
        for (done, piece) in pieces.iter().enumerate() {
            let progress = |share: f64| (run.progress)((done as f64 + share) / pieces.len() as f64);
            let out = self.output(piece, folder.path())?;
            costs.push(self.start(piece, &out, &Run { progress: &progress, ..*run })?);
        }
        Ok(costs)
    }

    /// Path of the image. A setting of the job may be part of its name, and the name part of a script.
    fn output(&self, piece: &Piece<'_>, folder: &Path) -> Result<PathBuf, RendererError> {
        let (name, values) = self.name(piece);
        let takes_name = |script: &Script<'_>| script.text.names().any(|name| name == "out");
        let is_in_script = self.renderer.file.scripts().iter().any(takes_name);
        let is_free = |name: &&str| is_in_script && self.renderer.file.is_free(name);
        let output = self.renderer.file.output.get_ref();
        let is_odd = |name: &&str| values.get(*name).is_none_or(|text| !is_plain(text));
        if let Some(wrong) = output.names().filter(is_free).find(is_odd) {
            let reason = format!(
                "it is part of the image's name, which a script takes: it may have ASCII letters, digits and {PLAIN} only, unless the \
                 renderer's file gives it `choices`"
            );
            return Err(SettingsError { path: format!("/own/{wrong}"), reason }.into());
        }
        if !Path::new(&name).components().all(|part| matches!(part, Component::Normal(_))) {
            return self.unsupported(&format!("writes {name:?}, which is not in its own folder"));
        }
        Ok(folder.join(name))
    }

    /// Name of the image, and the values in it.
    fn name(&self, piece: &Piece<'_>) -> (String, Values) {
        let mut values: Values = [("frame".to_owned(), piece.frame.to_string())].into();
        for (name, value) in self.description.settings.own.iter().chain(&piece.settings.own) {
            values.insert(name.clone(), plain(value));
        }
        (self.renderer.file.output.get_ref().fill(&values), values)
    }

    fn unsupported<T>(&self, reason: &str) -> Result<T, RendererError> {
        Err(RendererError::Unsupported(format!("{} {reason}", self.renderer.id().name)))
    }
}

/// A value as an argument.
fn plain(value: &Value) -> String {
    value.as_str().map_or_else(|| value.to_string(), str::to_owned)
}

/// The narrower of the run's and the file's limits.
fn limits(of_run: Limits, memory_mib: Option<u64>, seconds: Option<u64>) -> Limits {
    let memory = memory_mib.map(|mib| mib << 20);
    let time = seconds.map(Duration::from_secs);
    Limits {
        memory_bytes: of_run.memory_bytes.into_iter().chain(memory).min(),
        time: of_run.time.into_iter().chain(time).min(),
        ..of_run
    }
}

fn nanos(time: Duration) -> u64 {
    u64::try_from(time.as_nanos()).unwrap_or(u64::MAX)
}

impl Shot for CommandShot {
    fn description(&self) -> &Description {
        &self.description
    }

    fn capabilities(&self, _settings: &Settings) -> Capabilities {
        self.renderer.capabilities()
    }

    fn image_extensions(&self, settings: &Settings) -> Vec<String> {
        let piece = Piece { frame: 0, settings, samples: settings.common.samples, region: None };
        let (name, _) = self.name(&piece);
        Path::new(&name).extension().map(|end| end.to_string_lossy().into_owned()).into_iter().collect()
    }

    /// The command does not say what a pixel shows, so all of the image is of one unknown stratum.
    fn preview(
        &self,
        frames: &[i32],
        settings: &Settings,
        _run: &Run<'_>,
    ) -> Result<Vec<FrameCounts>, RendererError> {
        self.check(settings)?;
        frames.iter().try_for_each(|&frame| self.check_frame(frame))?;
        let whole = PixelCount { object: None, material: None, pixels: settings.pixels() };
        let counts = |&frame: &i32| FrameCounts {
            frame,
            counts: vec![whole],
            sampled_pixels: 0,
            backend: PreviewBackend::Renderer,
            cost: Cost::default(),
        };
        Ok(frames.iter().map(counts).collect())
    }

    fn measure(
        &self,
        frame: i32,
        settings: &Settings,
        part: &Part,
        run: &Run<'_>,
    ) -> Result<Measured, RendererError> {
        self.check(settings)?;
        self.check_frame(frame)?;
        part.check(&settings.common)?;
        let all = settings.common.samples;
        let piece = |samples, region| Piece { frame, settings, samples, region };
        let (pieces, regions) = match part {
            &Part::Samples { count, .. } => {
                if count != all && !self.can(Can::Samples) {
                    return self.unsupported("cannot render fewer samples");
                }
                (vec![piece(count, None)], &[][..])
            }
            Part::Regions(_) if !self.can(Can::Crop) => return self.unsupported("cannot render regions"),
            Part::Regions(regions) => {
                (regions.iter().map(|&region| piece(all, Some(region))).collect(), &regions[..])
            }
            Part::Pixels(_) => return self.unsupported("cannot measure single pixels"),
        };
        let costs = self.measure_pieces(&pieces, run)?;
        let mut cost = Cost::default();
        costs.iter().for_each(|one| cost += one);
        let piece = |(&region, cost): (&Region, &Cost)| PieceCost { region, cpu_nanos: cost.cpu_nanos };
        Ok(Measured {
            pieces: regions.iter().zip(&costs).map(piece).collect(),
            cost,
            fixed: FixedCosts::new(),
            strata: Vec::new(),
            blocks: None,
            ids: None,
            artefact: None,
            stopping: None,
        })
    }

    fn render(
        &self,
        frame: i32,
        settings: &Settings,
        taken_over: &[Artefact],
        run: &Run<'_>,
    ) -> Result<Rendered, RendererError> {
        self.check(settings)?;
        self.check_frame(frame)?;
        if let Some(artefact) = taken_over.first() {
            return Err(artefact.unusable(format!("{} takes nothing over", self.renderer.id().name)));
        }
        let piece = Piece { frame, settings, samples: settings.common.samples, region: None };
        let out = self.output(&piece, run.scratch)?;
        let cost = self.start(&piece, &out, run)?;
        Ok(Rendered {
            files: vec![out],
            picture: None,
            ids: None,
            cost,
            fixed: FixedCosts::new(),
            strata: Vec::new(),
            blocks: None,
            taken_over: TakenOver::default(),
        })
    }
}
