//! A plain command behind the renderer's door: any program that can only be started.
//!
//! A file `NAME.command.toml` describes the program and the scene:
//!
//! ```toml
//! name = "pov-ray"
//! version_command = ["povray", "--version"]       # or: version = "3.7"
//! version_pattern = 'POV-Ray (\S+)'               # one group; without it: the first line
//! scene = "hall.pov"                              # from this file's folder on
//! output = "frame-{frame:04}.png"                 # name of the image
//! arguments = ["povray", "{scene}", "+O{out}", "+W{width}", "+H{height}", "+K{frame}", "+WT{threads}",
//!              "+SC{crop_left}", "+SR{crop_top}", "+EC{crop_right}", "+ER{crop_bottom}", "+A{antialias}"]
//! can = ["size", "crop"]                          # of: samples, size, crop
//! pass_on = ["LD_LIBRARY_PATH"]                   # variables of this process that it gets
//! network = true                                  # reaches the network in a sandbox: for a licence server
//!
//! [frames]
//! first = 1
//! last = 24                                       # step = 1
//!
//! [defaults]
//! width = 640
//! height = 360                                    # samples = 1, seed = 0
//!
//! [crop]                                          # all of this table can be left out
//! first = 1                                       # number of the first column and row
//! inclusive = true                                # right and bottom are inside
//! # fractions = true                              # shares of width and height
//! # text = "{crop_left},{crop_top},{crop_right},{crop_bottom}"   what {crop} stands for
//!
//! [environment]
//! SCENES = "{folder}"
//!
//! [parameters.antialias]                          # a setting of its own
//! type = "number"                                 # or: integer, boolean, string
//! default = 0.3
//! minimum = 0                                     # maximum, choices, description
//!
//! [progress]
//! pattern = '\((\d+)%\)'                          # one group, a number
//! unit = "percent"                                # or: fraction
//!
//! [[errors]]
//! pattern = "Could not find file"                 # a regular expression
//! means = "missing_file"                          # or: licence, out_of_memory, gpu
//!
//! [limits]
//! memory_mib = 4096
//! seconds = 3600
//! ```
//!
//! Instead of `arguments`, the file may name an Open Job Description template, which other farms run too:
//!
//! ```toml
//! [openjd]
//! template = "hall.job.yaml"                      # or JSON
//! step = "Render"                                 # if several steps have a task parameter
//!
//! [openjd.parameters]                             # parameters of the job; the others have their defaults
//! Scene = "{scene}"
//! Out = "{out}"
//! Samples = "{samples}"
//! ```
//!
//! The step's only task parameter is the frame. Its command, arguments, embedded files, variables and time
//! limit are taken over, and its frames unless this file has some. Environments with actions are refused.
//!
//! Only the variables that this file names, `PATH`, `LANG`, `HOME` and `TMPDIR` are in the program's
//! environment. The last two are an empty folder, which is its working folder too.
//!
//! | placeholder | value |
//! | --- | --- |
//! | `{scene}` `{folder}` | absolute path of the scene, and of the folder of this file |
//! | `{out}` `{out_folder}` | absolute path of the image, and of its folder |
//! | `{frame}` | number of the frame; `{frame:04}` has four digits at least |
//! | `{width}` `{height}` `{samples}` `{seed}` `{threads}` | settings |
//! | `{crop_left}` `{crop_top}` `{crop_right}` `{crop_bottom}` | the region to render, or else the whole image |
//! | `{crop_width}` `{crop_height}` | its size |
//! | `{crop}` | the region as one text |
//! | `{NAME}` | the parameter `NAME` |
//!
//! `{{` and `}}` are braces. Parameters that are strings without `choices` are not parts of scripts: neither of
//! embedded files, nor of the argument after `-c` of a shell.
//!
//! | file | subject |
//! | --- | --- |
//! | `file` | the file's tables, and what is wrong with them |
//! | `template` | texts with placeholders |
//! | `openjd` | arguments from an Open Job Description template |
//! | `scripts` | texts that a shell runs |
//! | `installation` | finds the program and its version |
//! | `renderer` | the door: what the program can, and how it opens a scene |
//! | `shot` | the four questions of the door |
//! | `output` | progress and known messages |
//!
//! # Costs
//! A cost is the CPU time of the program and all its children, from its start to its end. It has a fixed
//! part, which nothing tells apart: starting, loading the scene, writing. So a forecast needs measurements at
//! two sizes, or two numbers of samples.

mod file;
mod installation;
mod openjd;
mod output;
mod renderer;
mod scripts;
mod shot;
mod template;

pub use installation::{CommandRenderer, EXTENSION, open_command};

/// Reads and checks a file, and starts nothing.
///
/// # Errors
/// What is wrong with it, and where.
pub fn check_file(path: &std::path::Path) -> Result<(), forelight_renderer::door::RendererError> {
    file::CommandFile::read(path).map(drop)
}
