//! Parses a stream of server-sent events (HTML standard, section 9.2).

/// One event.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct ServerEvent {
    /// The `id:` field. A client that resumes the stream sends it back as `Last-Event-ID`.
    pub id: Option<String>,
    /// The `event:` field; empty if there is none.
    pub kind: String,
    /// The `data:` lines, joined by line feeds.
    pub data: String,
}

/// Parses the bytes of a stream into complete events.
#[derive(Debug, Default)]
pub struct EventParser {
    line: Vec<u8>,
    after_carriage_return: bool,
    event: ServerEvent,
    has_data: bool,
}

/// Longest line, bytes. The rest of a longer line is dropped, to limit memory. The service never sends such
/// lines.
const LONGEST_LINE: usize = 1 << 20;

impl EventParser {
    /// Takes the next bytes of the stream, cut anywhere, and returns the events that they complete.
    pub fn feed(&mut self, bytes: &[u8]) -> Vec<ServerEvent> {
        let mut events = Vec::new();
        for &byte in bytes {
            // A line ends with CR, LF or CRLF.
            let line_feed_of_a_pair = byte == b'\n' && self.after_carriage_return;
            self.after_carriage_return = byte == b'\r';
            if line_feed_of_a_pair {
                continue;
            }
            if byte == b'\r' || byte == b'\n' {
                let line = std::mem::take(&mut self.line);
                self.end_of_line(&String::from_utf8_lossy(&line), &mut events);
            } else if self.line.len() < LONGEST_LINE {
                self.line.push(byte);
            }
        }
        events
    }

    fn end_of_line(&mut self, line: &str, events: &mut Vec<ServerEvent>) {
        if line.is_empty() {
            let event = std::mem::take(&mut self.event);
            if std::mem::take(&mut self.has_data) {
                events.push(event);
            }
            return;
        }
        let (field, value) = line.split_once(':').unwrap_or((line, ""));
        let value = value.strip_prefix(' ').unwrap_or(value);
        match field {
            "data" => {
                if self.has_data {
                    self.event.data.push('\n');
                }
                self.event.data.push_str(value);
                self.has_data = true;
            }
            "event" => self.event.kind = value.into(),
            "id" => self.event.id = Some(value.into()),
            // An empty field name is a comment (keep-alive). `retry` is ignored, because the client has its
            // own back-off.
            _ => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const STREAM: &str =
        ": keep-alive\n\nid: 7\nevent: frame\ndata: {\"a\":\ndata: 1}\n\nid:8\r\ndata:x\r\n\r\nid: 9\n";

    #[test]
    fn events_are_the_same_wherever_the_stream_is_cut() {
        let expected = [
            ServerEvent { id: Some("7".into()), kind: "frame".into(), data: "{\"a\":\n1}".into() },
            ServerEvent { id: Some("8".into()), kind: String::new(), data: "x".into() },
        ];
        for cut in 0..=STREAM.len() {
            let mut parser = EventParser::default();
            let mut events = parser.feed(&STREAM.as_bytes()[..cut]);
            events.extend(parser.feed(&STREAM.as_bytes()[cut..]));
            assert_eq!(events, expected, "cut at {cut}");
        }
    }
}
