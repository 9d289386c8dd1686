//! `forelight renderers`: what this machine renders with, and the settings of each renderer.

use anyhow::Result;
use forelight_preview::{Choice, SharedPreviewer};
use forelight_renderer::door::{Capabilities, Renderer, RendererId};
use forelight_terminal::foreign::installed;
use forelight_terminal::output;
use forelight_terminal::table::{Align, Table};
use serde::Serialize;
use serde_json::Value;
use std::path::PathBuf;
use std::sync::Arc;

/// List the renderers on this machine besides forelight's own, with their settings
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  forelight renderers
  forelight renderers --command povray.command.toml --json > renderers.json
  forelight forecast shot.blend --set denoise=false --set max_bounces=4
  forelight forecast hall.rif --set ambient_bounces=1 --set ambient_accuracy=0

A worker on this machine takes tasks of these renderers. Blender is the program `blender`, or a Python with the module \
bpy: the one that FORELIGHT_BPY_PYTHON names, or python3. Radiance is the program `rtrace` with its others, in PATH or in \
the folder that FORELIGHT_RADIANCE names. --set changes a setting; the JSON has their schemas.")]
pub struct Args {
    /// File that describes a renderer which can only be started, NAME.command.toml. May be repeated
    #[arg(long, value_name = "FILE")]
    command: Vec<PathBuf>,
    /// Print renderers, capabilities and schemas as JSON to standard output
    #[arg(long)]
    json: bool,
}

#[derive(Serialize)]
struct Document<'a> {
    #[serde(flatten)]
    id: &'a RendererId,
    capabilities: Capabilities,
    settings: Value,
}

pub fn run(args: &Args) -> Result<()> {
    // Nothing is previewed here.
    let previewer = Arc::new(SharedPreviewer::new(Choice::Cpu));
    let found = installed(&args.command, previewer)?;
    let documents: Vec<Document<'_>> = found.renderers.iter().map(|renderer| document(&**renderer)).collect();
    if args.json {
        return output::json(&documents);
    }
    let missing: String = found.missing.iter().map(|reason| format!("{reason}\n")).collect();
    let shown: Vec<String> = documents.iter().map(text).collect();
    output::print(&(shown.join("\n") + &missing))
}

fn document(renderer: &dyn Renderer) -> Document<'_> {
    Document {
        id: renderer.id(),
        capabilities: renderer.capabilities(),
        settings: renderer.settings_schema(),
    }
}

fn text(document: &Document<'_>) -> String {
    let mut table = Table::new(&[
        ("setting", Align::Left),
        ("value", Align::Left),
        ("default", Align::Left),
        ("meaning", Align::Left),
    ]);
    for (name, schema) in document.settings["properties"].as_object().into_iter().flatten() {
        let word = |key: &str| match &schema[key] {
            Value::Null => String::new(),
            Value::String(text) => text.clone(),
            other => other.to_string(),
        };
        let range = match (word("minimum"), word("maximum")) {
            (least, most) if !least.is_empty() && !most.is_empty() => format!(", {least} to {most}"),
            _ => String::new(),
        };
        table.row([name.clone(), word("type") + &range, word("default"), word("description")]);
    }
    format!("{}\n{}", document.id, table.render())
}
