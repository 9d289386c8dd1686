//! Radiance's own settings, and the arguments of its programs that they stand for.

use forelight_renderer::door::Settings;
use serde_json::{Map, Value, json};
use std::sync::LazyLock;

/// Kind of a setting's value.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    Integer,
    Number,
    Switch,
    /// Red, green and blue.
    Colour,
}

/// A setting and the option of `rtrace` that it stands for.
struct Known {
    name: &'static str,
    option: &'static str,
    kind: Kind,
    /// Least and largest value.
    range: Option<(f64, f64)>,
    description: &'static str,
}

const fn known(
    name: &'static str,
    option: &'static str,
    kind: Kind,
    range: Option<(f64, f64)>,
    description: &'static str,
) -> Known {
    Known { name, option, kind, range, description }
}

/// All settings.
const KNOWN: [Known; 19] = {
    use Kind::{Colour, Integer, Number, Switch};
    [
        known("ambient_bounces", "-ab", Integer, Some((0.0, 100.0)), "Bounces of indirect light."),
        known(
            "ambient_accuracy",
            "-aa",
            Number,
            Some((0.0, 1.0)),
            "Error of interpolated indirect light. 0: every pixel gathers for itself.",
        ),
        known("ambient_divisions", "-ad", Integer, Some((0.0, 1e6)), "Rays that a point gathers with."),
        known(
            "ambient_super_samples",
            "-as",
            Integer,
            Some((0.0, 1e6)),
            "Further rays where the first ones differ.",
        ),
        known(
            "ambient_resolution",
            "-ar",
            Integer,
            Some((0.0, 1e6)),
            "Values are at least the scene's size over this apart, times the accuracy. 0: no limit.",
        ),
        known(
            "ambient_value",
            "-av",
            Colour,
            None,
            "Indirect light where nothing is gathered: red, green, blue.",
        ),
        known(
            "ambient_weight",
            "-aw",
            Integer,
            Some((0.0, 1e6)),
            "Weight of ambient_value against gathered values.",
        ),
        known(
            "direct_threshold",
            "-dt",
            Number,
            Some((0.0, 1.0)),
            "Shadows are tested down to this contrast.",
        ),
        known("direct_certainty", "-dc", Number, Some((0.0, 1.0)), "Certainty of this contrast."),
        known(
            "direct_jitter",
            "-dj",
            Number,
            Some((0.0, 1.0)),
            "Jitter of shadow rays over a light, for soft shadows.",
        ),
        known(
            "direct_sampling",
            "-ds",
            Number,
            Some((0.0, 1e6)),
            "Largest size of a part of a light, over its distance.",
        ),
        known("direct_relays", "-dr", Integer, Some((0.0, 100.0)), "Mirrors between a light and a surface."),
        known(
            "direct_pretest",
            "-dp",
            Integer,
            Some((0.0, 1e6)),
            "Rays that test whether mirrors relay a light.",
        ),
        known(
            "specular_sampling",
            "-ss",
            Number,
            Some((0.0, 1e6)),
            "Rays of a rough reflection. 0: no jitter.",
        ),
        known("specular_threshold", "-st", Number, Some((0.0, 1.0)), "Least reflection that is traced."),
        known(
            "max_reflections",
            "-lr",
            Integer,
            Some((-100.0, 100.0)),
            "Most reflections. Negative or 0: the weakest rays survive by chance, up to this number.",
        ),
        known("min_weight", "-lw", Number, Some((0.0, 1.0)), "Least weight of a ray."),
        known("uncorrelated", "-u", Switch, None, "Uncorrelated random numbers."),
        known("back_faces", "-bv", Switch, None, "Whether the backs of surfaces are seen."),
    ]
};

/// Options that a scene may have and a job cannot change, with the number of their values.
const KEPT: [(&str, usize); 11] = [
    ("-me", 3),
    ("-ma", 3),
    ("-mg", 1),
    ("-ms", 1),
    ("-dv", 0),
    ("-ai", 1),
    ("-aI", 1),
    ("-ae", 1),
    ("-aE", 1),
    ("-am", 1),
    ("-i", 0),
];

/// Options of a picture that have no meaning here, with the number of their values. The last is the ambient
/// file.
const IGNORED: [(&str, usize); 13] = [
    ("-ps", 1),
    ("-pt", 1),
    ("-pj", 1),
    ("-pm", 1),
    ("-pd", 1),
    ("-pa", 1),
    ("-x", 1),
    ("-y", 1),
    ("-t", 1),
    ("-z", 1),
    ("-w", 0),
    ("-n", 1),
    ("-af", 1),
];

/// The schema of the settings that other renderers do not have.
pub(crate) static SCHEMA: LazyLock<Value> = LazyLock::new(|| {
    let property = |known: &Known| {
        let mut schema = match known.kind {
            Kind::Integer => json!({"type": "integer"}),
            Kind::Number => json!({"type": "number"}),
            Kind::Switch => json!({"type": "boolean"}),
            Kind::Colour => {
                json!({"type": "array", "items": {"type": "number", "minimum": 0}, "minItems": 3, "maxItems": 3})
            }
        };
        if let Some((least, most)) = known.range {
            schema["minimum"] = least.into();
            schema["maximum"] = most.into();
        }
        schema["description"] = format!("{} ({})", known.description, known.option).into();
        (known.name.to_owned(), schema)
    };
    let mut properties: Map<String, Value> = KNOWN.iter().map(property).collect();
    properties.insert(
        ALLOW_MISSING.to_owned(),
        json!({"type": "boolean", "default": false,
            "description": "Render although files that the scene refers to are missing."}),
    );
    json!({"type": "object", "additionalProperties": false, "properties": properties})
});

/// Setting that allows missing files.
pub(crate) const ALLOW_MISSING: &str = "allow_missing";

/// What a list of arguments says.
#[derive(Debug, Default, PartialEq)]
pub(crate) struct Arguments {
    /// Settings by name.
    pub settings: Map<String, Value>,
    /// Other arguments, which the renderer gets as they are.
    pub kept: Vec<String>,
    /// The file of ambient values, if one is named.
    pub ambient_file: Option<String>,
}

impl Arguments {
    /// Reads options of rtrace or rpict. Options of the view are skipped.
    pub fn read(words: &[String]) -> Result<Self, String> {
        let mut found = Self::default();
        let mut rest = words;
        while let Some((option, after)) = rest.split_first() {
            rest = found.take(option, after)?;
        }
        Ok(found)
    }

    /// Takes an option and its values, and returns what comes after.
    fn take<'a>(&mut self, option: &str, after: &'a [String]) -> Result<&'a [String], String> {
        let values = |count: usize| {
            after.split_at_checked(count).ok_or_else(|| format!("option {option} needs {count} values"))
        };
        let (bare, switch) = switched(option);
        if let Some(known) = KNOWN.iter().find(|known| known.option == bare) {
            let count = match known.kind {
                Kind::Integer | Kind::Number => 1,
                Kind::Switch => 0,
                Kind::Colour => 3,
            };
            let (own, rest) = values(count)?;
            self.settings.insert(known.name.to_owned(), known.value(own, switch)?);
            return Ok(rest);
        }
        if let Some(&(_, count)) = KEPT.iter().find(|(kept, _)| *kept == bare) {
            let (own, rest) = values(count)?;
            self.kept.push(option.to_owned());
            self.kept.extend_from_slice(own);
            return Ok(rest);
        }
        if let Some(&(name, count)) = IGNORED.iter().find(|(ignored, _)| *ignored == bare) {
            let (own, rest) = values(count)?;
            if name == "-af" {
                self.ambient_file = own.first().cloned();
            }
            return Ok(rest);
        }
        match view_values(bare) {
            Some(count) => Ok(values(count)?.1),
            None => Err(format!("option {option} is not known")),
        }
    }
}

/// The option without its `+` or `-`, and what that says. A switch alone is switched on.
fn switched(option: &str) -> (&str, bool) {
    match option
        .strip_suffix(['+', '1'])
        .or_else(|| option.strip_suffix(['-', '0']).filter(|o| !o.is_empty()))
    {
        Some(bare) if bare.len() > 1 => (bare, option.ends_with(['+', '1'])),
        _ => (option, true),
    }
}

/// Number of values of an option of the view. `None` if it is not one.
pub(crate) fn view_values(option: &str) -> Option<usize> {
    let kind = option.strip_prefix("-v")?;
    match kind {
        "p" | "d" | "u" => Some(3),
        "h" | "v" | "o" | "a" | "s" | "l" | "f" => Some(1),
        _ if kind.len() == 2 && kind.starts_with('t') => Some(0),
        _ => None,
    }
}

impl Known {
    fn value(&self, words: &[String], switch: bool) -> Result<Value, String> {
        let wrong = |word: &str| format!("option {}: `{word}` is not a number", self.option);
        let number =
            |word: &String| word.parse::<f64>().ok().filter(|n| n.is_finite()).ok_or_else(|| wrong(word));
        match self.kind {
            Kind::Switch => Ok(switch.into()),
            Kind::Colour => words.iter().map(number).collect::<Result<Vec<f64>, _>>().map(Value::from),
            Kind::Number => Ok(number(&words[0])?.into()),
            // Radiance reads 1.5 as 1.
            Kind::Integer => Ok((number(&words[0])? as i64).into()),
        }
    }

    fn arguments(&self, value: &Value) -> Vec<String> {
        match value {
            Value::Bool(on) => vec![format!("{}{}", self.option, if *on { '+' } else { '-' })],
            Value::Array(numbers) => {
                std::iter::once(self.option.to_owned()).chain(numbers.iter().map(Value::to_string)).collect()
            }
            number => vec![self.option.to_owned(), number.to_string()],
        }
    }
}

/// The arguments of rtrace at these settings.
pub(crate) fn arguments(settings: &Settings) -> Vec<String> {
    let of = |known: &Known| settings.own.get(known.name).map(|value| known.arguments(value));
    KNOWN.iter().filter_map(of).flatten().collect()
}

/// The settings that `rtrace -defaults` prints.
pub(crate) fn defaults(lines: &[String]) -> Map<String, Value> {
    let mut all = Map::new();
    for line in lines {
        let words: Vec<String> =
            line.split('#').next().unwrap_or_default().split_whitespace().map(str::to_owned).collect();
        // Lines about other things are left out.
        if let Ok(found) = Arguments::read(&words) {
            all.extend(found.settings);
        }
    }
    all
}

/// An integer of the settings, or else 0.
pub(crate) fn integer(settings: &Settings, name: &str) -> i64 {
    settings.own.get(name).and_then(Value::as_i64).unwrap_or(0)
}

/// A number of the settings, or else 0.
pub(crate) fn number(settings: &Settings, name: &str) -> f64 {
    settings.own.get(name).and_then(Value::as_f64).unwrap_or(0.0)
}

/// Whether pixels share values of indirect light, so that a pixel's cost depends on those before it.
pub(crate) fn shares_values(settings: &Settings) -> bool {
    integer(settings, "ambient_bounces") > 0
        && integer(settings, "ambient_divisions") > 0
        && number(settings, "ambient_accuracy") > 0.0
}

/// Whether missing files are allowed.
pub(crate) fn allows_missing(settings: &Settings) -> bool {
    settings.own.get(ALLOW_MISSING).and_then(Value::as_bool).unwrap_or(false)
}

#[cfg(test)]
mod tests {
    use super::*;
    use forelight_renderer::door::Common;

    fn words(text: &str) -> Vec<String> {
        text.split_whitespace().map(str::to_owned).collect()
    }

    fn with(own: Map<String, Value>) -> Settings {
        Settings { common: Common { width: 8, height: 8, samples: 1, seed: 0 }, own }
    }

    #[test]
    fn options_become_settings_and_settings_options() {
        let text =
            "-vp 0 1 2 -vth -ab 2 -aa .1 -ad 64 -av .1 .2 .3 -u+ -lr -10 -bv- -ms 0.5 -ps 4 -af x.amb -x 64";
        let found = Arguments::read(&words(text)).unwrap();
        assert_eq!(found.kept, ["-ms", "0.5"]);
        assert_eq!(found.ambient_file.as_deref(), Some("x.amb"));
        let settings = with(found.settings);
        assert_eq!(settings.check(&SCHEMA), Ok(()));
        let expected = words("-ab 2 -aa 0.1 -ad 64 -av 0.1 0.2 0.3 -lr -10 -u+ -bv-");
        assert_eq!(arguments(&settings), expected);
        assert!(shares_values(&settings));
    }

    #[test]
    fn unknown_options_and_missing_values_are_named() {
        for (text, reason) in [
            ("-zz 3", "option -zz is not known"),
            ("-av 1 2", "option -av needs 3 values"),
            ("-ab many", "option -ab: `many` is not a number"),
            ("room.oct", "option room.oct is not known"),
        ] {
            assert_eq!(Arguments::read(&words(text)).unwrap_err(), reason);
        }
    }

    #[test]
    fn defaults_are_read_and_other_lines_left_out() {
        let lines =
            ["-x 0        # flush interval", "-u+   # uncorrelated", "-ab 0   # bounces", "-pRGB   # colour"];
        let found = defaults(&lines.map(str::to_owned));
        assert_eq!(Value::Object(found), json!({"uncorrelated": true, "ambient_bounces": 0}));
    }

    #[test]
    fn pixels_share_values_only_with_bounces_rays_and_accuracy() {
        let shares = |text: &str| shares_values(&with(Arguments::read(&words(text)).unwrap().settings));
        assert!(shares("-ab 1 -aa .2 -ad 256"));
        assert!(!shares("-ab 0 -aa .2 -ad 256"));
        assert!(!shares("-ab 1 -aa 0 -ad 256"));
        assert!(!shares("-ab 1 -aa .2 -ad 0"));
    }
}
