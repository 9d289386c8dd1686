//! Files that a scene refers to: pictures, data and functions of its patterns, meshes and other octrees.

use forelight_renderer::door::{Asset, AssetState};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// Places of files among the string arguments of a modifier or surface, by its type.
const FILES: [(&str, &str, &[usize]); 15] = [
    ("picture", "colorpict", &[3]),
    ("picture", "mixpict", &[3]),
    ("data", "brightdata", &[1]),
    ("data", "colordata", &[3, 4, 5]),
    ("data", "texdata", &[3, 4, 5]),
    ("data", "mixdata", &[3]),
    ("function", "brightfunc", &[1]),
    ("function", "colorfunc", &[3]),
    ("function", "texfunc", &[3]),
    ("function", "mixfunc", &[3]),
    ("mesh", "mesh", &[0]),
    ("octree", "instance", &[0]),
    ("data", "BSDF", &[1]),
    ("data", "aBSDF", &[0]),
    ("data", "specdata", &[1]),
];

/// Files that a flat description of a scene names, as `xform -e` writes it, each once. `folders` are where
/// Radiance looks for them.
pub(crate) fn assets_of(flat: &str, folders: &[PathBuf]) -> Vec<Asset> {
    let mut seen = BTreeSet::new();
    let mut assets = Vec::new();
    for (kind, name) in named(flat) {
        if seen.insert(name) {
            assets.push(asset(kind, name, folders));
        }
    }
    assets
}

/// A file, and whether it is in one of the folders.
pub(crate) fn asset(kind: &str, name: &str, folders: &[PathBuf]) -> Asset {
    let mut places = folders.iter().map(|folder| folder.join(name));
    let found = places.find(|place| place.is_file());
    let state = if found.is_some() { AssetState::Present } else { AssetState::Missing };
    let path = found.unwrap_or_else(|| folders.first().map_or_else(|| PathBuf::from(name), |f| f.join(name)));
    Asset { kind: kind.to_owned(), name: base(name), path: path.display().to_string(), state }
}

fn base(name: &str) -> String {
    Path::new(name).file_name().map_or_else(|| name.to_owned(), |base| base.to_string_lossy().into_owned())
}

/// Kinds and names of files, in the order of the text. What is not understood ends it.
fn named(flat: &str) -> Vec<(&'static str, &str)> {
    let lines = flat.lines().map(str::trim_start).filter(|line| !line.starts_with(['#', '!']));
    let mut words = lines.flat_map(str::split_whitespace);
    let mut found = Vec::new();
    while let (Some(_), Some(kind), Some(_)) = (words.next(), words.next(), words.next()) {
        if kind == "alias" {
            words.next();
            continue;
        }
        let mut count = || words.next().and_then(|word| word.parse::<usize>().ok());
        let Some(strings) = count() else { break };
        let strings: Vec<&str> = words.by_ref().take(strings).collect();
        let mut count = || words.next().and_then(|word| word.parse::<usize>().ok());
        let Some(integers) = count() else { break };
        words.by_ref().take(integers).for_each(drop);
        let Some(reals) = words.next().and_then(|word| word.parse::<usize>().ok()) else { break };
        words.by_ref().take(reals).for_each(drop);
        for (what, _, places) in FILES.iter().filter(|(_, of, _)| *of == kind) {
            found.extend(places.iter().filter_map(|&at| Some((*what, *strings.get(at)?))));
        }
    }
    // A point stands for no file, and `!` begins a command.
    found.retain(|(_, name)| *name != "." && !name.starts_with('!'));
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    const FLAT: &str = "# xform -e
void colorpict wood
7 red green blue wood.hdr . frac(Lu) frac(Lv)
0
0
wood plastic board 0 0 5 1 1 1 0 0
void alias other board
board mesh chair 1 chair.rtm 0 0
void brightfunc sky 2 skybr skybright.cal 0 0
void instance tree 1 tree.oct 0 0
other polygon floor 0 0 9 0 0 0 1 0 0 1 1 0
board mesh chair2 3 chair.rtm -t 0 0 0";

    #[test]
    fn files_of_patterns_and_instances_are_found_or_missing() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["wood.hdr", "skybright.cal"] {
            std::fs::write(folder.path().join(name), "").unwrap();
        }
        let found = assets_of(FLAT, &[folder.path().to_owned()]);
        let names: Vec<(&str, &str, bool)> = found
            .iter()
            .map(|a| (a.kind.as_str(), a.name.as_str(), a.state == AssetState::Present))
            .collect();
        let expected = [
            ("picture", "wood.hdr", true),
            ("mesh", "chair.rtm", false),
            ("function", "skybright.cal", true),
            ("octree", "tree.oct", false),
        ];
        assert_eq!(names, expected);
        assert!(found[1].path.ends_with("/chair.rtm"));
    }

    #[test]
    fn text_that_is_no_scene_names_nothing() {
        assert!(assets_of("a b c d e f", &[]).is_empty());
        assert!(assets_of("", &[]).is_empty());
    }
}
