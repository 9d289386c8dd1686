//! What an answer holds until it was sent whole, or its client is gone.

use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};

use axum::body::{Body, Bytes, HttpBody};
use http_body::{Frame, SizeHint};
use parking_lot::Mutex;

use super::admission::{RequestSeat, Standing};
use crate::quotas::InFlight;

/// What a request holds. Each request carries it.
#[derive(Clone)]
pub(crate) struct Holds(Arc<Held>);

struct Held {
    seat: RequestSeat,
    quota: Mutex<Option<InFlight>>,
}

impl Holds {
    pub fn new(seat: RequestSeat) -> Self {
        Self(Arc::new(Held { seat, quota: Mutex::new(None) }))
    }

    /// The request has shown whose it is, and counts among that caller's.
    pub fn show(&self, standing: Standing, quota: Option<InFlight>) {
        self.0.seat.show(standing);
        *self.0.quota.lock() = quota;
    }

    /// The body of the request's answer.
    pub fn until_sent(self, body: Body) -> Body {
        Body::new(Answer { body, _holds: self })
    }
}

struct Answer {
    body: Body,
    _holds: Holds,
}

impl HttpBody for Answer {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        Pin::new(&mut self.body).poll_frame(context)
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}
