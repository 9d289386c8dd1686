//! A scene: octrees and views of its frames, options and files.

use crate::assets::{asset, assets_of};
use crate::installation::{MESSAGES, Radiance};
use crate::rif::Plan;
use crate::settings::Arguments;
use crate::views::{View, views_of};
use forelight_kept::TemporaryFolder;
use forelight_renderer::door::{Asset, Cost, Frames, RendererError, Run};
use forelight_renderer::process::{Program, run, run_on_files};
use std::fs::{self, File};
use std::io::{Read as _, Seek as _};
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Width and height of an image at most, where the scene does not say.
const SIDE: u32 = 512;

/// Missing octrees that an error names at most.
const NAMED: usize = 3;

/// A frame: the octree that holds its scene, and its view.
#[derive(Debug, Clone)]
pub(crate) struct SceneFrame {
    pub number: i32,
    pub octree: PathBuf,
    pub view: View,
}

/// A scene that is open.
#[derive(Debug)]
pub(crate) struct Scene {
    /// Folder from which the scene names its files.
    pub folder: PathBuf,
    /// Home of our processes, with the octree if it was built here. Removed with this.
    pub home: TemporaryFolder,
    pub frames: Vec<SceneFrame>,
    pub arguments: Arguments,
    /// Width and height at most.
    pub size: (u32, u32),
    /// Samples of a pixel.
    pub samples: u32,
    pub assets: Vec<Asset>,
    pub notes: Vec<String>,
    /// Cost of opening it.
    pub cost: Cost,
}

/// Reads a scene.
struct Reader<'a> {
    radiance: &'a Radiance,
    scene: &'a Path,
    folder: PathBuf,
    home: TemporaryFolder,
    run: &'a Run<'a>,
    cost: Cost,
}

impl Scene {
    /// Opens a `.rif` file, which builds its octree, or an octree with a view file beside it.
    pub fn open(radiance: &Radiance, scene: &Path, run: &Run<'_>) -> Result<Self, RendererError> {
        if !scene.is_file() {
            return Err(RendererError::MissingFile(scene.display().to_string()));
        }
        let scene = std::path::absolute(scene).map_err(RendererError::io(scene))?;
        let folder = scene.parent().unwrap_or(Path::new("/")).to_owned();
        let home = TemporaryFolder::new().map_err(RendererError::io(std::env::temp_dir()))?;
        let reader = Reader { radiance, scene: &scene, folder, home, run, cost: Cost::default() };
        if scene.extension().is_some_and(|end| end.eq_ignore_ascii_case("rif")) {
            reader.of_rif()
        } else {
            reader.of_octree()
        }
    }

    /// The frame of this number.
    pub fn frame(&self, number: i32) -> Result<&SceneFrame, RendererError> {
        self.frames.iter().find(|frame| frame.number == number).ok_or_else(|| {
            let frames = self.numbers();
            RendererError::Unsupported(format!("there is no frame {number}; the scene has {frames}"))
        })
    }

    /// Numbers of the frames, which are evenly spaced.
    pub fn numbers(&self) -> Frames {
        let numbers = || self.frames.iter().map(|frame| frame.number);
        let (first, last) = (numbers().next().unwrap_or(1), numbers().next_back().unwrap_or(0));
        Frames { first, last, step: numbers().nth(1).map_or(1, |second| second.abs_diff(first)) }
    }
}

impl Reader<'_> {
    fn wrong(&self, reason: String) -> RendererError {
        RendererError::Scene { scene: self.scene.to_owned(), reason }
    }

    fn program(&self, name: &str) -> Program {
        self.radiance.program(name, &self.folder, self.home.path())
    }

    fn of_rif(mut self) -> Result<Scene, RendererError> {
        // A picture and an octree that do not exist: rad prints all that it would do for them.
        let nowhere = self.home.path().join("none");
        let octree = self.home.path().join("scene.oct");
        let mut printed = Vec::new();
        let rad = |own_octree: bool| {
            let program = self.program("rad").args(["-n", "-e"]).arg(self.scene);
            let program = program.arg(format!("PICTURE={}", nowhere.join("picture").display()));
            if own_octree { program.arg(format!("OCTREE={}", octree.display())) } else { program }
        };
        let names_scene = fs::read_to_string(self.scene)
            .map_err(RendererError::io(self.scene))?
            .lines()
            .any(|line| line.trim_start().to_lowercase().starts_with("scene"));
        let since = Instant::now();
        let finished =
            run(&rad(names_scene), MESSAGES, self.run, &mut |line| printed.push(line.text.clone()))?;
        self.add(finished.usage.cpu_nanos, since);
        let plan = Plan::read(&printed).map_err(|reason| self.wrong(reason))?;
        let folders = self.folders();
        let mut assets: Vec<Asset> =
            plan.files.iter().map(|(kind, name)| asset(kind, name, &folders[..1])).collect();
        let octree = if plan.oconv.is_empty() {
            let named = plan.octree.as_deref().ok_or_else(|| self.wrong("it names no scene".to_owned()))?;
            self.folder.join(named)
        } else {
            self.build(&plan.oconv, &octree)?;
            if self.radiance.knows_folders() {
                assets.extend(self.assets(&plan.read, &folders)?);
            }
            octree
        };
        if !octree.is_file() {
            return Err(RendererError::MissingFile(octree.display().to_string()));
        }
        let mut notes = Vec::new();
        if runs_commands(&plan.read, &self.folder) {
            notes.push(
                "the scene runs commands (lines that begin with !) when its octree is built".to_owned(),
            );
        }
        if plan.arguments.ambient_file.is_some() {
            notes.push("AMBFILE is not used: it would be shared with other renders of the scene".to_owned());
        }
        let frame =
            |(view, number): (&View, i32)| SceneFrame { number, octree: octree.clone(), view: view.clone() };
        let frames = plan.views.iter().zip(1..).map(frame).collect();
        let samples = plan.oversampling * plan.oversampling;
        Ok(self.into_scene(frames, plan.arguments, plan.size, samples, assets, notes))
    }

    fn of_octree(self) -> Result<Scene, RendererError> {
        let mut octrees = numbered(self.scene);
        let own = self.scene.with_extension("vf");
        // The number of a lone octree, or of one with several views, is a part of its name.
        if octrees.len() == 1 || own.is_file() && read_views(&own)?.len() > 1 {
            octrees.clear();
        }
        if let Some(missing) = gaps(&octrees) {
            return Err(self.wrong(format!(
                "octrees are missing between its frames: {missing}; make them, or move the octrees that are no \
                 frames of this shot to a folder of their own"
            )));
        }
        let views = self.views(&octrees)?;
        let frame = |number: i32, octree: &Path, view: &View| SceneFrame {
            number,
            octree: octree.to_owned(),
            view: view.clone(),
        };
        let frames: Vec<SceneFrame> = match octrees.as_slice() {
            [] => views.iter().zip(1..).map(|(view, number)| frame(number, self.scene, view)).collect(),
            octrees => {
                if views.len() != 1 && views.len() != octrees.len() {
                    return Err(self.wrong(format!(
                        "there are {} octrees and {} views; give one view, or one for each octree",
                        octrees.len(),
                        views.len()
                    )));
                }
                let of = views.iter().cycle();
                octrees.iter().zip(of).map(|((number, octree), view)| frame(*number, octree, view)).collect()
            }
        };
        let assets = octrees.iter().map(|(_, path)| self.present("octree", path)).collect();
        Ok(self.into_scene(frames, Arguments::default(), (SIDE, SIDE), 1, assets, Vec::new()))
    }

    /// Views of octrees: of the files of the same names, or of one file for all of them.
    fn views(&self, octrees: &[(i32, PathBuf)]) -> Result<Vec<View>, RendererError> {
        let each: Vec<PathBuf> = octrees.iter().map(|(_, octree)| octree.with_extension("vf")).collect();
        if each.len() > 1 && each.iter().all(|path| path.is_file()) {
            let last = |path: &PathBuf| read_views(path).map(|mut views| views.pop());
            return Ok(each.iter().map(last).collect::<Result<Vec<_>, _>>()?.into_iter().flatten().collect());
        }
        let own = self.scene.with_extension("vf");
        let name = stem(self.scene);
        let (prefix, _) = split_number(&name);
        let common = self.folder.join(format!("{}.vf", prefix.trim_end_matches(['.', '-', '_'])));
        match [&own, &common].into_iter().find(|path| path.is_file()) {
            Some(path) => read_views(path),
            None => Err(RendererError::MissingFile(format!("{}: the views of the octree", own.display()))),
        }
    }

    fn folders(&self) -> Vec<PathBuf> {
        std::iter::once(self.folder.clone()).chain(self.radiance.folders_of_files()).collect()
    }

    fn add(&mut self, cpu_nanos: u64, since: Instant) {
        self.cost.cpu_nanos += cpu_nanos;
        self.cost.wall_nanos += u64::try_from(since.elapsed().as_nanos()).unwrap_or(u64::MAX);
    }

    fn on_files(&mut self, program: &Program, out: File) -> Result<(), RendererError> {
        let since = Instant::now();
        let from = File::open("/dev/null").map_err(RendererError::io("/dev/null"))?;
        let finished = run_on_files(program, MESSAGES, self.run, from, out)?;
        self.add(finished.usage.cpu_nanos, since);
        Ok(())
    }

    fn build(&mut self, arguments: &[String], octree: &Path) -> Result<(), RendererError> {
        let oconv = self.program("oconv").args(arguments);
        self.on_files(&oconv, File::create_new(octree).map_err(RendererError::io(octree))?)
    }

    /// Files that the scene's own files name.
    fn assets(&mut self, files: &[String], folders: &[PathBuf]) -> Result<Vec<Asset>, RendererError> {
        // Commands of the scene have run by now. They cannot put anything in the place of a file without a name.
        let failed = || RendererError::io(std::env::temp_dir());
        let mut flat = tempfile::tempfile().map_err(failed())?;
        let xform = self.program("xform").arg("-e").args(files);
        self.on_files(&xform, flat.try_clone().map_err(failed())?)?;
        let mut text = Vec::new();
        flat.rewind().and_then(|()| flat.read_to_end(&mut text)).map_err(failed())?;
        Ok(assets_of(&String::from_utf8_lossy(&text), folders))
    }

    fn present(&self, kind: &str, path: &Path) -> Asset {
        asset(kind, &path.display().to_string(), std::slice::from_ref(&self.folder))
    }

    fn into_scene(
        self,
        frames: Vec<SceneFrame>,
        arguments: Arguments,
        size: (u32, u32),
        samples: u32,
        assets: Vec<Asset>,
        notes: Vec<String>,
    ) -> Scene {
        let Self { folder, home, cost, .. } = self;
        Scene { folder, home, frames, arguments, size, samples, assets, notes, cost }
    }
}

fn read_views(path: &Path) -> Result<Vec<View>, RendererError> {
    views_of(path).map_err(|reason| RendererError::Scene { scene: path.to_owned(), reason })
}

/// Whether one of the files has a line that is a command.
fn runs_commands(files: &[String], folder: &Path) -> bool {
    files.iter().any(|file| {
        let text = fs::read(folder.join(file)).unwrap_or_default();
        String::from_utf8_lossy(&text).lines().any(|line| line.trim_start().starts_with('!'))
    })
}

fn stem(path: &Path) -> String {
    path.file_stem().unwrap_or_default().to_string_lossy().into_owned()
}

/// `hall-` and `0012` of `hall-0012`.
fn split_number(stem: &str) -> (&str, &str) {
    let prefix = stem.trim_end_matches(|c: char| c.is_ascii_digit());
    stem.split_at(prefix.len())
}

/// Octrees whose names differ from this one's only in their number, ascending. Empty if it has no number.
fn numbered(octree: &Path) -> Vec<(i32, PathBuf)> {
    let own = stem(octree);
    let (prefix, number) = split_number(&own);
    if number.parse::<i32>().is_err() {
        return Vec::new();
    }
    let entries = octree.parent().and_then(|folder| fs::read_dir(folder).ok());
    let mut all: Vec<(i32, PathBuf)> = entries
        .into_iter()
        .flatten()
        .flatten()
        .map(|entry| entry.path())
        .filter(|path| path.extension() == octree.extension())
        .filter_map(|path| {
            let name = stem(&path);
            let (others, number) = split_number(&name);
            let number = number.parse().ok().filter(|_| others == prefix)?;
            Some((number, path))
        })
        .collect();
    all.sort();
    all.dedup_by_key(|(number, _)| *number);
    all
}

/// Names of the first octrees that are missing, and how many others are. `None` if the numbers, which ascend,
/// are evenly spaced.
fn gaps(octrees: &[(i32, PathBuf)]) -> Option<String> {
    let ((first, path), (last, _)) = (octrees.first()?, octrees.last()?);
    let steps = octrees.windows(2).map(|pair| pair[0].0.abs_diff(pair[1].0));
    let step = steps.reduce(greatest_common_divisor)?;
    let missing = (last.abs_diff(*first) / step) as usize + 1 - octrees.len();
    let name = stem(path);
    let (prefix, digits) = split_number(&name);
    let end = path.extension().map_or_else(String::new, |end| format!(".{}", end.display()));
    let names: Vec<String> = (*first..*last)
        .step_by(step as usize)
        .filter(|number| octrees.binary_search_by_key(number, |(number, _)| *number).is_err())
        .take(NAMED)
        .map(|number| format!("{prefix}{number:0width$}{end}", width = digits.len()))
        .collect();
    let others = missing - names.len();
    let others = if others > 0 { format!(" and {others} more") } else { String::new() };
    (missing > 0).then(|| names.join(", ") + &others)
}

fn greatest_common_divisor(a: u32, b: u32) -> u32 {
    if b == 0 { a } else { greatest_common_divisor(b, a % b) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn octrees_that_differ_in_their_number_are_frames() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["walk-002.oct", "walk-010.oct", "walk-9.oct", "talk-003.oct", "walk.oct", "walk-004.vf"]
        {
            fs::write(folder.path().join(name), "").unwrap();
        }
        let numbers = |name: &str| -> Vec<i32> {
            numbered(&folder.path().join(name)).into_iter().map(|(number, _)| number).collect()
        };
        assert_eq!(numbers("walk-010.oct"), [2, 9, 10]);
        assert_eq!(numbers("talk-003.oct"), [3]);
        assert!(numbers("walk.oct").is_empty());
        assert!(numbers("walk-99999999999.oct").is_empty(), "it is too large for a number of a frame");
    }

    #[test]
    fn octrees_that_are_missing_between_others_are_named() {
        let gaps = |names: &[&str]| {
            let number = |name: &&str| split_number(&stem(name.as_ref())).1.parse().unwrap();
            gaps(&names.iter().map(|name| (number(name), PathBuf::from(name))).collect::<Vec<_>>())
        };
        assert_eq!(gaps(&["walk0002.oct", "walk0003.oct", "walk0004.oct"]), None);
        assert_eq!(gaps(&["walk2.oct", "walk4.oct", "walk6.oct"]), None);
        assert_eq!(gaps(&["walk2.oct", "walk9.oct"]), None);
        assert_eq!(gaps(&[]), None);
        let missing = gaps(&["walk0002.oct", "walk0009.oct", "walk0010.oct"]).unwrap();
        assert_eq!(missing, "walk0003.oct, walk0004.oct, walk0005.oct and 3 more");
        assert_eq!(gaps(&["walk2.oct", "walk4.oct", "walk8.oct"]).as_deref(), Some("walk6.oct"));
        let far = gaps(&["day0.oct", "day1.oct", "day2147483647.oct"]).unwrap();
        assert_eq!(far, "day2.oct, day3.oct, day4.oct and 2147483642 more");
    }
}
