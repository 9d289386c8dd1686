//! Extracts values from requests, with errors that name the place.

mod auth;
mod body;
mod idempotency;
mod json;
mod objects;
mod path;
mod query;
mod reach;
mod version;

pub(crate) use auth::{
    Anyone, OneTimeToken, Operator, Peer, PeerAddress, Reader, Submitter, UNKNOWN_TOKEN, WorkerToken,
};
pub(crate) use body::{announced_length, whole, within_announced_length};
pub(crate) use idempotency::KeyHeader;
pub(crate) use json::{JsonBody, Large, OfStrangers, media_type};
pub(crate) use path::{Segment, Segments};
pub(crate) use query::{QueryParameters, number, number_if_any};
pub(crate) use reach::{FarmReader, OwnJob, SeenFrame, SeenJob, check_may_change};
pub(crate) use version::WorkerVersion;
