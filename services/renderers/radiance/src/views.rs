//! Views: the arguments that state one, and the files that hold several.

use crate::settings::view_values;
use std::path::Path;

/// A view. A frame shows the scene through one.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct View {
    /// Its name. Empty if it has none.
    pub name: String,
    /// Arguments of vwrays.
    pub arguments: Vec<String>,
}

/// What begins a view in a file.
const TAG: &str = "VIEW=";

/// Beginnings of the options that shape the image of a view.
const SHAPING: [&str; 4] = ["-vt", "-vh", "-vv", "-vf"];

impl View {
    /// Reads the words of a `view=` line: a name, which may be left out, and options.
    pub fn read(words: &[String]) -> Result<Self, String> {
        let (name, arguments) = match words.split_first() {
            Some((name, rest)) if !name.starts_with('-') => (name.clone(), rest),
            _ => (String::new(), words),
        };
        let mut rest = arguments;
        while let Some((option, after)) = rest.split_first() {
            let count =
                view_values(option).ok_or_else(|| format!("view: option {option} is not one of a view"))?;
            rest = after.get(count..).ok_or_else(|| format!("view: option {option} needs {count} values"))?;
        }
        if arguments.is_empty() {
            return Err("view: it has no options".to_owned());
        }
        Ok(Self { name, arguments: arguments.to_vec() })
    }

    /// The options that shape its image: kind and angles, and files that may state them. Of several options of
    /// a kind, the last counts.
    pub fn shape(&self) -> Vec<&[String]> {
        let mut all: Vec<&[String]> = Vec::new();
        let mut rest = self.arguments.as_slice();
        while let Some(option) = rest.first() {
            let count = 1 + view_values(option).unwrap_or(0);
            let (own, after) = rest.split_at(count.min(rest.len()));
            rest = after;
            let Some(kind) = SHAPING.into_iter().find(|kind| option.starts_with(kind)) else { continue };
            // A file may state any of the options, so each of them is kept.
            all.retain(|other| kind == "-vf" || !other[0].starts_with(kind));
            all.push(own);
        }
        all
    }
}

/// Reads the views of a view file or of a picture's header. As in `rpict -S`, each changes the one before it.
pub(crate) fn views_of(path: &Path) -> Result<Vec<View>, String> {
    let text = std::fs::read(path).map_err(|error| error.to_string())?;
    let mut views: Vec<View> = Vec::new();
    for line in String::from_utf8_lossy(&text).lines() {
        let line = line.trim_start();
        // Programs such as rvu write their own name instead of the tag.
        let Some(options) = line.strip_prefix(TAG).or_else(|| line.strip_prefix("rvu ")) else { continue };
        let words: Vec<String> = options.split_whitespace().map(str::to_owned).collect();
        let mut view = View::read(&words)?;
        if let Some(before) = views.last() {
            view.arguments.splice(0..0, before.arguments.iter().cloned());
        }
        views.push(view);
    }
    if views.is_empty() { Err(format!("no line begins with {TAG}")) } else { Ok(views) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn words(text: &str) -> Vec<String> {
        text.split_whitespace().map(str::to_owned).collect()
    }

    #[test]
    fn a_view_has_options_and_perhaps_a_name() {
        let view = View::read(&words("front -vtv -vp 1 2 3 -vd 0 1 0")).unwrap();
        assert_eq!((view.name.as_str(), view.arguments.len()), ("front", 9));
        assert_eq!(View::read(&words("-vf a.vf")).unwrap().name, "");
        for (text, reason) in [
            ("front", "no options"),
            ("-vp 1 2", "needs 3 values"),
            ("-vh 60 -af stolen", "option -af is not one of a view"),
            ("front side -vh 60", "option side"),
        ] {
            let error = View::read(&words(text)).unwrap_err();
            assert!(error.contains(reason), "{error}");
        }
    }

    #[test]
    fn the_last_kind_and_angles_of_a_view_shape_its_image() {
        let shape = |text: &str| View::read(&words(text)).unwrap().shape().concat().join(" ");
        assert_eq!(shape("-vtv -vp 1 2 3 -vh 60 -vv 46 -vd 0 1 0"), "-vtv -vh 60 -vv 46");
        assert_eq!(shape("-vtv -vh 60 -vv 46 -vp 1 0 1 -vth -vh 30"), "-vv 46 -vth -vh 30");
        assert_eq!(shape("-vh 60 -vf a.vf -vh 30 -vf b.vf -vf a.vf"), "-vf a.vf -vh 30 -vf b.vf -vf a.vf");
    }

    #[test]
    fn a_file_has_a_view_in_each_line_which_changes_the_one_before_it() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("walk.vf");
        std::fs::write(&path, "rvu -vtv -vp 0 0 1 -vh 60\nVIEW= -vp 1 0 1\n\nVIEW= -vh 30\n").unwrap();
        let views = views_of(&path).unwrap();
        let lengths: Vec<usize> = views.iter().map(|view| view.arguments.len()).collect();
        assert_eq!(lengths, [7, 11, 13]);
        assert!(views[2].arguments.ends_with(&words("-vp 1 0 1 -vh 30")));
        std::fs::write(&path, "nothing").unwrap();
        assert!(views_of(&path).unwrap_err().contains("VIEW="));
    }
}
