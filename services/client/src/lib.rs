//! A client of the service's REST API: typed calls, retries, events. Workers, the command line and tests use
//! it. The only other crate of forelight that it needs is `forelight-protocol`.
//!
//! | file | subject |
//! | --- | --- |
//! | `client` | a client: address, token, back-off |
//! | `calls` | the typed calls, a file for each subject |
//! | `transport` | sends a request until it is answered |
//! | `upload` | sends long bodies, and gives up those whose connection falls silent |
//! | `token` | the bearer token, and its file |
//! | `backoff` | how long to wait before the next attempt |
//! | `server_events` | parses a stream of server-sent events |
//! | `error` | why a request failed |

mod backoff;
mod calls;
mod client;
mod error;
mod server_events;
mod token;
mod transport;
mod upload;

pub use backoff::Backoff;
pub use calls::{Claimed, EventStream, FramePicture};
pub use client::Client;
pub use error::ClientError;
pub use server_events::{EventParser, ServerEvent};
pub use token::Token;
