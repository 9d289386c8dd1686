//! The service's REST API as a client sees it: typed calls, retries, events.
//!
//! Workers, the command line and tests use it. It depends on the words on the wire (`forelight-protocol`) and on no
//! other crate of forelight.
//!
//! | file | subject |
//! | --- | --- |
//! | `client` | a client: address, token, back-off |
//! | `calls` | the typed calls, a file for each subject |
//! | `transport` | sends a request until it is answered |
//! | `backoff` | how long to wait before the next attempt |
//! | `server_events` | parses a stream of server-sent events |
//! | `error` | why a request failed |

mod backoff;
mod calls;
mod client;
mod error;
mod server_events;
mod transport;

pub use backoff::Backoff;
pub use calls::{Claimed, EventStream, FramePicture};
pub use client::Client;
pub use error::ClientError;
pub use server_events::{EventParser, ServerEvent};
pub use transport::Token;
