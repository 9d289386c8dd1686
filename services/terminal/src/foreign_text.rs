//! Text that others wrote, on a terminal: names, errors and logs.
//!
//! Hazard: control characters move the cursor, clear the screen or set its title. Characters that change the
//! direction of text, or have no width, make a name look like another one. So all of them are shown as what
//! they are, such as `\u{202e}`. What is printed goes through here: see `output`, `table` and the log.

use std::borrow::Cow;
use tracing_subscriber::field::MakeExt as _;
use tracing_subscriber::fmt::FormatFields;
use tracing_subscriber::fmt::format::debug_fn;

/// Text in one line, as it is shown.
pub fn shown(text: &str) -> Cow<'_, str> {
    escaped(text, |_, _| false)
}

/// Text of several lines, as it is shown.
pub fn shown_lines(text: &str) -> Cow<'_, str> {
    escaped(text, |c, rest| c == '\n' || c == '\t' || (c == '\r' && rest.starts_with('\n')))
}

/// The same JSON, with escapes for what serde leaves as it is.
pub fn shown_json(json: String) -> String {
    if !json.contains(|c: char| c != '\n' && is_deceptive(c)) {
        return json;
    }
    let mut shown = String::with_capacity(json.len() + 16);
    for c in json.chars() {
        if c == '\n' || !is_deceptive(c) {
            shown.push(c);
            continue;
        }
        // JSON knows characters by their UTF-16 code units (RFC 8259, section 7).
        for unit in c.encode_utf16(&mut [0; 2]) {
            shown += &format!("\\u{unit:04x}");
        }
    }
    shown
}

/// Fields of log lines, with the text of others as it is shown.
pub fn log_fields() -> impl for<'writer> FormatFields<'writer> + 'static {
    debug_fn(|writer, field, value| {
        let text = format!("{value:?}");
        match field.name() {
            "message" => write!(writer, "{}", shown(&text)),
            name => write!(writer, "{name}={}", shown(&text)),
        }
    })
    .delimited(" ")
}

fn escaped(text: &str, stays: impl Fn(char, &str) -> bool) -> Cow<'_, str> {
    if !text.contains(is_deceptive) {
        return Cow::Borrowed(text);
    }
    let mut shown = String::with_capacity(text.len() + 16);
    for (at, c) in text.char_indices() {
        if is_deceptive(c) && !stays(c, &text[at + c.len_utf8()..]) {
            shown.extend(c.escape_default());
        } else {
            shown.push(c);
        }
    }
    Cow::Owned(shown)
}

/// Whether a character is a control, a line separator, or one that has no width of its own: those of the
/// general category Cf, and fillers (Unicode 16, `Default_Ignorable_Code_Point`), but for the selectors that
/// choose between forms of an emoji.
fn is_deceptive(c: char) -> bool {
    c.is_control()
        || matches!(c,
            '\u{ad}' | '\u{34f}' | '\u{61c}' | '\u{6dd}' | '\u{70f}' | '\u{8e2}' | '\u{600}'..='\u{605}'
            | '\u{115f}' | '\u{1160}' | '\u{17b4}' | '\u{17b5}' | '\u{180b}'..='\u{180f}'
            | '\u{200b}'..='\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2060}'..='\u{206f}' | '\u{3164}'
            | '\u{feff}' | '\u{ffa0}' | '\u{fff0}'..='\u{fffb}' | '\u{110bd}' | '\u{110cd}'
            | '\u{13430}'..='\u{1343f}' | '\u{1bca0}'..='\u{1bca3}' | '\u{1d173}'..='\u{1d17a}'
            | '\u{e0000}'..='\u{e0fff}')
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_others_wrote_cannot_steer_a_terminal_or_look_like_something_else() {
        assert_eq!(shown("\x1b[2J\x07\r"), "\\u{1b}[2J\\u{7}\\r");
        assert_eq!(shown("a\nforged line\tb\u{9b}1m"), "a\\nforged line\\tb\\u{9b}1m");
        assert_eq!(
            shown("gpj.\u{202e}exe\u{200b}\u{feff}\u{e0041}"),
            "gpj.\\u{202e}exe\\u{200b}\\u{feff}\\u{e0041}"
        );
        for plain in ["été 木 🎬 ❤\u{fe0f} |a| \\n", ""] {
            assert!(matches!(shown(plain), Cow::Borrowed(same) if same == plain));
        }
    }

    #[test]
    fn our_own_lines_stay_lines() {
        assert_eq!(shown_lines("a\tb\r\nc\n"), "a\tb\r\nc\n");
        assert_eq!(shown_lines("a\rb\u{2028}\n"), "a\\rb\\u{2028}\n");
    }

    #[test]
    fn json_stays_the_same_document() {
        let value = serde_json::json!({"na\u{202e}me": ["\u{9b}\u{e0041}", "plain\n", "木"]});
        let json = serde_json::to_string_pretty(&value).unwrap();
        let shown = shown_json(json.clone());
        assert!(shown.contains("na\\u202eme") && shown.contains("\\u009b\\udb40\\udc41"), "{shown}");
        assert_eq!(serde_json::from_str::<serde_json::Value>(&shown).unwrap(), value);
        assert_eq!(shown_json("{\n}".to_owned()), "{\n}");
    }

    #[test]
    fn log_lines_show_what_others_wrote() {
        use parking_lot::Mutex;
        use std::io::Write;
        use std::sync::Arc;
        #[derive(Clone, Default)]
        struct Log(Arc<Mutex<Vec<u8>>>);
        impl Write for Log {
            fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
                self.0.lock().write(bytes)
            }
            fn flush(&mut self) -> std::io::Result<()> {
                Ok(())
            }
        }
        let log = Log::default();
        let writer = log.clone();
        let subscriber = tracing_subscriber::fmt()
            .fmt_fields(log_fields())
            .with_ansi(false)
            .with_writer(move || writer.clone())
            .finish();
        tracing::subscriber::with_default(subscriber, || {
            let (name, count) = ("a\u{202e}b\nc", 3);
            tracing::warn!(%name, count, "{name} is \x1b[31mred");
        });
        let text = String::from_utf8(log.0.lock().clone()).unwrap();
        let line = text.strip_suffix('\n').unwrap();
        assert!(line.ends_with("a\\u{202e}b\\nc is \\u{1b}[31mred name=a\\u{202e}b\\nc count=3"), "{line}");
    }
}
