//! The service's REST API as a client sees it: typed requests, retries, events.
//!
//! Workers, the command line and tests use it. It knows the words on the wire (`forelight-protocol`) and nothing else of forelight.
//!
//! | file | subject |
//! | --- | --- |
//! | `client` | the API as typed calls |
//! | `transport` | sends a request until it is answered |
//! | `backoff` | how long to wait before the next attempt |
//! | `server_events` | cuts server-sent events out of a byte stream |

mod backoff;
mod client;
mod server_events;
mod transport;

pub use backoff::Backoff;
pub use client::{Claimed, Client, EventStream, FramePicture};
pub use server_events::{EventParser, ServerEvent};
pub use transport::{ClientError, Token};
