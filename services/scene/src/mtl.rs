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
/// The supported values of `illum`.
const MODELS: [u8; 6] = [0, 1, 2, 3, 4, 7];

/// Checks a `.mtl` file. Returns supported keys in canonical form, and counts of the others.
pub(crate) fn check(file: &str, bytes: &[u8]) -> Result<(String, BTreeMap<String, usize>), SceneError> {
    let text = text(file, bytes)?;
    let (mut canonical, mut ignored) = (String::new(), BTreeMap::new());
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
        match value(key, rest).map_err(|reason| SceneError::line(file, i + 1, reason))? {
            Some(value) => {
                // Writing to a string cannot fail.
                let _ = writeln!(canonical, "{key} {value}");
            }
            None => *ignored.entry(key.to_owned()).or_insert(0) += 1,
        }
    }
    Ok((canonical, ignored))
}

/// The canonical value of a key. `None` if the key is not supported.
fn value(key: &str, rest: &str) -> Result<Option<String>, String> {
    let value = match key {
        "newmtl" | "map_Kd" if rest.is_empty() => return Err(format!("`{key}` needs a name")),
        "map_Kd" if rest.starts_with('-') => {
            return Err(format!("`map_Kd {rest}`: texture options are not supported"));
        }
        "newmtl" | "map_Kd" => rest.to_owned(),
        "Kd" | "Ks" | "Tf" => colour(key, rest, 1.0)?,
        "Ke" => colour(key, rest, 1e12)?,
        "Ni" => number(key, rest, 0.1, 10.0)?.to_string(),
        "Pr" | "d" => number(key, rest, 0.0, 1.0)?.to_string(),
        "priority" => match rest.parse::<NonZeroU8>() {
            Ok(priority) => priority.to_string(),
            Err(_) => return Err(format!("`priority {rest}` is not a whole number from 1 to 255")),
        },
        "illum" => match rest.parse::<u8>() {
            Ok(model) if MODELS.contains(&model) => model.to_string(),
            _ => return Err(format!("`illum {rest}` is not one of 0, 1, 2, 3, 4, 7")),
        },
        _ => return Ok(None),
    };
    Ok(Some(value))
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
        let (canonical, _) = check("a.mtl", b"newmtl a\n Kd 0.5\r\n").unwrap();
        assert_eq!(canonical, "newmtl a\nKd 0.5 0.5 0.5\n");
        let error = check("a.mtl", b"newmtl a\nKd 0.5 0.5").unwrap_err().to_string();
        assert_eq!(error, "a.mtl: line 2: `Kd` takes 3 numbers, not 2");
    }

    #[test]
    fn keys_that_are_not_listed_are_counted() {
        let (_, ignored) = check("a.mtl", b"newmtl a\nNs 3\nPm 1\nnewmtl b\nPm 0\n").unwrap();
        assert_eq!(ignored, BTreeMap::from([("Ns".to_owned(), 1), ("Pm".to_owned(), 2)]));
    }
}
