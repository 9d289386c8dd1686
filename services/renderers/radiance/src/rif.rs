//! Files of the program `rad`: what they say of octree, views and options.
//!
//! `rad -n` prints what it would do. Nothing of it is run here: the octree is built in a folder of our own,
//! so that several processes can open one scene.

use crate::settings::Arguments;
use crate::views::View;
use std::collections::BTreeMap;

/// Variables that name files of the scene.
const FILES: [&str; 3] = ["materials", "scene", "objects"];

/// What a file says.
#[derive(Debug, Default, PartialEq)]
pub(crate) struct Plan {
    /// Arguments of oconv: options and files. Empty if there is only an octree.
    pub oconv: Vec<String>,
    /// The octree that the file names.
    pub octree: Option<String>,
    /// Files of the scene, by the kind of their variable.
    pub files: Vec<(&'static str, String)>,
    /// Files whose objects oconv reads, in its order.
    pub read: Vec<String>,
    pub views: Vec<View>,
    pub arguments: Arguments,
    /// Width and height at most.
    pub size: (u32, u32),
    /// Samples of a pixel in each direction.
    pub oversampling: u32,
}

impl Plan {
    /// Reads what `rad -n -e` prints.
    pub fn read(lines: &[String]) -> Result<Self, String> {
        let mut variables: BTreeMap<String, Vec<String>> = BTreeMap::new();
        let mut commands = Vec::new();
        for line in lines {
            if let Some(command) = line.strip_prefix('\t') {
                commands.push(words(command));
            } else if let Some((name, value)) = line.split_once('=') {
                variables.entry(name.trim().to_lowercase()).or_default().push(value.trim().to_owned());
            }
        }
        if variables.contains_key("illum") {
            let reason = "illum: secondary sources are not made here; run rad once, and open the octree";
            return Err(reason.to_owned());
        }
        let all = |name: &str| variables.get(name).into_iter().flatten().flat_map(|value| words(value));
        let first = |name: &str| variables.get(name).and_then(|values| values.first());
        let mut plan = Self {
            octree: first("octree").cloned(),
            oconv: oconv(&commands)?,
            files: FILES.into_iter().flat_map(|kind| all(kind).map(move |file| (kind, file))).collect(),
            read: all("materials").chain(all("scene")).collect(),
            oversampling: oversampling(&commands),
            ..Self::default()
        };
        for value in variables.get("view").into_iter().flatten() {
            plan.views.push(View::read(&words(value))?);
        }
        if plan.views.is_empty() {
            return Err("view: the file has none".to_owned());
        }
        let render = commands.iter().find(|command| command.first().is_some_and(|name| name == "rpict"));
        let render = render.ok_or("rad prints no command that renders")?;
        // Between the program and `OCTREE > PICTURE`.
        let end = render.iter().position(|word| word == ">").unwrap_or(render.len()).saturating_sub(1);
        plan.arguments = Arguments::read(render.get(1..end).unwrap_or_default())?;
        plan.size = size(first("resolution").map_or("512", String::as_str))?;
        Ok(plan)
    }
}

fn words(text: &str) -> Vec<String> {
    text.split_whitespace().map(str::to_owned).collect()
}

/// Arguments of the one command that builds the octree.
fn oconv(commands: &[Vec<String>]) -> Result<Vec<String>, String> {
    let mut builders = commands.iter().filter(|command| command.first().is_some_and(|name| name == "oconv"));
    let Some(builder) = builders.next() else { return Ok(Vec::new()) };
    if builders.next().is_some() {
        return Err("the octree is built in several steps; run rad once, and open the octree".to_owned());
    }
    let end = builder.iter().position(|word| word == ">").unwrap_or(builder.len());
    Ok(builder[1..end].to_vec())
}

/// `3` of `pfilt … -x /3 -y /3`.
fn oversampling(commands: &[Vec<String>]) -> u32 {
    let filter = commands.iter().find(|command| command.first().is_some_and(|name| name == "pfilt"));
    let words = filter.map_or(&[][..], Vec::as_slice);
    let of_x = words.windows(2).find(|pair| pair[0] == "-x").and_then(|pair| pair[1].strip_prefix('/'));
    of_x.and_then(|number| number.parse().ok()).filter(|number| (1..=16).contains(number)).unwrap_or(1)
}

/// `512` or `512 384`.
fn size(text: &str) -> Result<(u32, u32), String> {
    let numbers: Option<Vec<u32>> =
        text.split_whitespace().map(|word| word.parse().ok().filter(|size| *size > 0)).collect();
    match numbers.as_deref() {
        Some(&[side]) => Ok((side, side)),
        Some(&[width, height]) => Ok((width, height)),
        _ => Err(format!("RESOLUTION: `{}` is not one or two numbers of pixels", text.escape_debug())),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    const PRINTED: &str = "OCTREE=x.oct
PICTURE=room
RESOLUTION= 512 384
materials= m.mat
scene= s.rad t.rad
objects= lamp.rad
view= front -vp 2 .2 1.5 -vd 0 1 0
view= -vf side.vf
\toconv -r 4096 m.mat s.rad t.rad > /tmp/o.oct
\trpict -vp 2 .2 1.5 -vd 0 1 0 -x 1536 -y 1536 -dp 4096 -ab 1 -aa .1 -ps 3 -pt .04 /tmp/o.oct > p.unf
\tpfilt -1 -e 2 -m .25 -x /3 -y /3 p.unf > p.hdr";

    fn read(text: &str) -> Result<Plan, String> {
        Plan::read(&text.lines().map(str::to_owned).collect::<Vec<_>>())
    }

    #[test]
    fn a_file_says_how_its_octree_is_built_and_its_views_rendered() {
        let plan = read(PRINTED).unwrap();
        assert_eq!(plan.oconv, ["-r", "4096", "m.mat", "s.rad", "t.rad"]);
        assert_eq!(plan.read, ["m.mat", "s.rad", "t.rad"]);
        assert_eq!(plan.files.last(), Some(&("objects", "lamp.rad".to_owned())));
        assert_eq!(plan.views.iter().map(|view| view.name.as_str()).collect::<Vec<_>>(), ["front", ""]);
        assert_eq!((plan.size, plan.oversampling), ((512, 384), 3));
        let settings = json!({"direct_pretest": 4096, "ambient_bounces": 1, "ambient_accuracy": 0.1});
        assert_eq!(serde_json::Value::Object(plan.arguments.settings), settings);
    }

    #[test]
    fn what_cannot_be_done_here_is_named() {
        let without_views: String =
            PRINTED.lines().filter(|l| !l.starts_with("view")).collect::<Vec<_>>().join("\n");
        for (text, reason) in [
            (format!("illum= window.rad\n{PRINTED}"), "illum"),
            (without_views, "view: the file has none"),
            (PRINTED.replace("512 384", "large"), "RESOLUTION"),
            (PRINTED.replace("512 384", "5\r x"), "RESOLUTION: `5\\r x` is"),
            (PRINTED.replace("-ps 3", "-zz 3"), "option -zz"),
            (PRINTED.replace("\tpfilt", "\toconv a.rad > a.oct\n\tpfilt"), "several steps"),
        ] {
            let error = read(&text).unwrap_err();
            assert!(error.contains(reason), "{error}");
        }
    }
}
