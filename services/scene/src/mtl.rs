//! Reads the materials of OBJ files. [`check`] runs before `tobj`, which gives no line numbers and panics on
//! a colour of two numbers.

use crate::assembly::{Assembly, plain_material};
use crate::error::{Place, SceneError};
use crate::obj_text::{text, without_comment};
use crate::{Color, Material, Surface};
use glam::Vec3;
use std::collections::BTreeMap;
use std::fmt::Write;
use std::num::NonZeroU8;

/// Index of refraction without `Ni`.
const DEFAULT_IOR: f32 = 1.5;

/// A checked `.mtl` file.
#[derive(Default)]
pub(crate) struct Checked {
    /// Its supported keys in canonical form.
    pub(crate) canonical: String,
    /// Its other keys, and the number of times that each occurs.
    pub(crate) ignored: BTreeMap<String, usize>,
    /// Values that do not mean here all that they mean elsewhere, and the number of times that each occurs.
    pub(crate) simplified: BTreeMap<String, usize>,
}

/// Checks a `.mtl` file.
pub(crate) fn check(file: &str, bytes: &[u8]) -> Result<Checked, SceneError> {
    let text = text(file, bytes)?;
    let Checked { mut canonical, mut ignored, mut simplified } = Checked::default();
    let mut in_material = false;
    for (i, line) in text.lines().enumerate() {
        let line = line.trim();
        let (key, rest) = line.split_once(char::is_whitespace).unwrap_or((line, ""));
        // Names may contain `#`, which begins a comment elsewhere.
        let rest = if matches!(key, "newmtl" | "map_Kd") { rest } else { without_comment(rest) }.trim();
        if key.is_empty() || key.starts_with('#') {
            continue;
        }
        if key == "newmtl" {
            in_material = true;
        } else if !in_material {
            return Err(SceneError::line(file, i + 1, format!("`{key}` comes before the first `newmtl`")));
        }
        match value(key, rest, &mut simplified).map_err(|reason| SceneError::line(file, i + 1, reason))? {
            Some(value) => {
                // Writing to a string cannot fail.
                let _ = writeln!(canonical, "{key} {value}");
            }
            None => *ignored.entry(key.to_owned()).or_insert(0) += 1,
        }
    }
    Ok(Checked { canonical, ignored, simplified })
}

/// The canonical value of a key. `None` if the key is not supported.
fn value(key: &str, rest: &str, simplified: &mut BTreeMap<String, usize>) -> Result<Option<String>, String> {
    let mut simplify = |what: String| *simplified.entry(what).or_insert(0) += 1;
    let value = match key {
        "newmtl" if rest.is_empty() => return Err("`newmtl` needs a name".into()),
        "newmtl" => rest.to_owned(),
        "map_Kd" => texture_name(rest, simplify)?.to_owned(),
        "Kd" | "Ks" | "Tf" => colour(key, rest, 1.0)?,
        "Ke" => colour(key, rest, 1e12)?,
        "Ni" if rest.parse() == Ok(0.0) => {
            simplify("Ni 0".into());
            DEFAULT_IOR.to_string()
        }
        "Ni" => number(key, rest, 0.1, 10.0)?.to_string(),
        "d" if rest.starts_with("-halo") => {
            simplify("d -halo".into());
            number(key, rest["-halo".len()..].trim_start(), 0.0, 1.0)?.to_string()
        }
        "Pr" | "d" => number(key, rest, 0.0, 1.0)?.to_string(),
        "priority" => match rest.parse::<NonZeroU8>() {
            Ok(priority) => priority.to_string(),
            Err(_) => return Err(format!("`priority {rest}` is not a whole number from 1 to 255")),
        },
        "illum" => match rest.parse::<u8>() {
            Ok(model @ (0..=4 | 7)) => model.to_string(),
            Ok(model @ (5 | 6 | 8..=10)) => {
                simplify(format!("illum {model}"));
                // 5 is a metal if the material has `Ks`, which may come later.
                if model == 5 { "5" } else { "2" }.into()
            }
            _ => return Err(format!("`illum {rest}` is not a whole number from 0 to 10")),
        },
        _ => return Ok(None),
    };
    Ok(Some(value))
}

/// The file name behind the options of a texture, which are not supported. Notes those that would change the
/// picture.
fn texture_name(rest: &str, mut simplify: impl FnMut(String)) -> Result<&str, String> {
    let mut name = rest;
    while name.starts_with('-') {
        let (option, values) = word(name);
        let (least, most) = match option {
            "-blendu" | "-blendv" | "-bm" | "-boost" | "-cc" | "-clamp" | "-imfchan" | "-texres"
            | "-type" => (1, 1),
            "-mm" => (2, 2),
            "-o" | "-s" | "-t" => (1, 3),
            _ => return Err(format!("`map_Kd`: `{option}` is not an option of a texture")),
        };
        name = values;
        let mut given = Vec::new();
        while given.len() < most && !name.is_empty() {
            let (value, next) = word(name);
            // The file name may come after the first or second number.
            if most == 3 && value.parse::<f32>().is_err() {
                break;
            }
            given.push(value);
            name = next;
        }
        if given.len() < least {
            return Err(format!("`map_Kd`: `{option}` needs {least} or more values"));
        }
        if changes(option, &given) {
            simplify(format!("map_Kd {option}"));
        }
    }
    if name.is_empty() { Err("`map_Kd` needs a name".into()) } else { Ok(name) }
}

/// The first word of a text, and the rest.
fn word(text: &str) -> (&str, &str) {
    text.split_once(char::is_whitespace).map_or((text, ""), |(word, rest)| (word, rest.trim_start()))
}

/// Whether an option of a texture has other values than its defaults, and would change a colour by that.
fn changes(option: &str, values: &[&str]) -> bool {
    let are = |number: f32| values.iter().all(|value| value.parse() == Ok(number));
    match option {
        "-blendu" | "-blendv" => values != ["on"],
        "-cc" | "-clamp" => values != ["off"],
        "-o" | "-t" => !are(0.0),
        "-s" => !are(1.0),
        "-mm" => values.iter().map(|value| value.parse().ok()).ne([Some(0.0), Some(1.0f32)]),
        _ => false,
    }
}

fn number(key: &str, text: &str, lowest: f32, highest: f32) -> Result<f32, String> {
    let value: f32 = text.parse().map_err(|_| format!("`{key}`: `{text}` is not a number"))?;
    if !(lowest..=highest).contains(&value) {
        return Err(format!("`{key}`: {value} is not in the range {lowest} to {highest}"));
    }
    Ok(value)
}

/// Parses three numbers, or one that stands for all three.
fn colour(key: &str, text: &str, highest: f32) -> Result<String, String> {
    let mut channels = Vec::new();
    for word in text.split_whitespace() {
        channels.push(number(key, word, 0.0, highest)?);
    }
    match channels[..] {
        [grey] => Ok(format!("{grey} {grey} {grey}")),
        [r, g, b] => Ok(format!("{r} {g} {b}")),
        _ => Err(format!("`{key}` takes 3 numbers, not {}", channels.len())),
    }
}

/// Converts a checked material. `file` is the `.mtl` file.
pub(crate) fn material(
    assembly: &mut Assembly<'_>,
    file: &str,
    source: &tobj::Material,
) -> Result<Material, SceneError> {
    let fail = |reason: String| SceneError::file(file, format!("material `{}`: {reason}", source.name));
    let texture = match &source.diffuse_texture {
        Some(reference) => {
            let path = crate::bundle::resolve(file, reference).map_err(&fail)?;
            let context = format!("material `{}`: `map_Kd`", source.name);
            let loaded = assembly.textures.load(&path);
            let checked = loaded.and_then(|id| assembly.textures.check_reflectance(id).map(|()| id));
            Some(checked.map_err(|e| e.within(file, Place::Whole, &context))?)
        }
        None => None,
    };
    let rgb = |value: Option<[f32; 3]>| value.map(Vec3::from_array);
    // The texture replaces `Kd`; the two are not multiplied.
    let albedo = match texture {
        Some(_) => Color { factor: Vec3::ONE, texture },
        None => Color::plain(rgb(source.diffuse).unwrap_or(Vec3::splat(0.5))),
    };
    let specular = rgb(source.specular).filter(|ks| *ks != Vec3::ZERO);
    let ior = source.optical_density.unwrap_or(DEFAULT_IOR);
    let roughness: f32 = unlisted(source, "Pr").and_then(|text| text.parse().ok()).unwrap_or(0.0);
    let alpha = roughness * roughness;
    let transmittance = Color::plain(filter(source));
    let model = source.illumination_model.unwrap_or(1);
    let surface = match (model, specular) {
        (2, Some(_)) => Surface::Plastic { albedo, ior, alpha },
        (3, _) => match rgb(source.specular) {
            Some(f0) => Surface::Metal { f0: Color::plain(f0), alpha },
            None => return Err(fail("`illum 3` needs `Ks`, the reflectance of the metal".into())),
        },
        (5, Some(f0)) => Surface::Metal { f0: Color::plain(f0), alpha },
        (4, _) => Surface::ThinGlass { ior, transmittance },
        (7, _) => {
            let priority = unlisted(source, "priority").and_then(|text| text.parse().ok());
            Surface::Glass { ior, transmittance, alpha, priority }
        }
        _ => Surface::Lambert { albedo },
    };
    let mut material = plain_material(&source.name, surface);
    material.emission = Color::plain(rgb(source.emissive).unwrap_or(Vec3::ZERO));
    if !matches!(model, 4 | 7) {
        material.opacity = source.dissolve.unwrap_or(1.0);
    }
    Ok(material)
}

/// `Tf`, the fraction of light transmitted per channel. White if absent.
fn filter(source: &tobj::Material) -> Vec3 {
    let mut words = unlisted(source, "Tf").unwrap_or_default().split_whitespace();
    let mut channel = || words.next().and_then(|w| w.parse().ok()).unwrap_or(1.0);
    Vec3::new(channel(), channel(), channel())
}

/// The value of a key that `tobj` does not know.
fn unlisted<'a>(source: &'a tobj::Material, key: &str) -> Option<&'a str> {
    source.unknown_param.get(key).map(String::as_str)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_colour_of_one_number_is_grey_and_of_two_is_refused() {
        let checked = check("a.mtl", b"newmtl a\n Kd 0.5\r\n").unwrap();
        assert_eq!(checked.canonical, "newmtl a\nKd 0.5 0.5 0.5\n");
        let error = check("a.mtl", b"newmtl a\nKd 0.5 0.5").err().unwrap().to_string();
        assert_eq!(error, "a.mtl: line 2: `Kd` takes 3 numbers, not 2");
    }

    #[test]
    fn keys_that_are_not_listed_are_counted() {
        let checked = check("a.mtl", b"newmtl a\nNs 3\nPm 1\nnewmtl b\nPm 0\n").unwrap();
        assert_eq!(checked.ignored, BTreeMap::from([("Ns".to_owned(), 1), ("Pm".to_owned(), 2)]));
    }
}
