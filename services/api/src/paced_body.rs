//! Bodies that come too slowly are given up.
//!
//! Hazard: a client that sends a byte now and then would hold what an upload holds, such as disk space, for as
//! long as it likes. So a body may wait for its client for a grace, and beyond that as long as the bytes that
//! came would take at the least rate; and never longer than a time in all. Only waiting for the client counts.

use std::pin::Pin;
use std::task::{Context, Poll, ready};
use std::time::Duration;

use axum::body::{Body, Bytes, HttpBody};
use http_body::{Frame, SizeHint};
use tokio::time::{Instant, Sleep, sleep_until};

use crate::config::UploadLimits;

/// A body that is given up if it comes too slowly.
pub(crate) struct PacedBody {
    body: Body,
    limits: UploadLimits,
    bytes: u64,
    waited: Duration,
    /// Since when the body waits for its client, and when that is too long.
    waits: Option<(Instant, Pin<Box<Sleep>>)>,
}

impl PacedBody {
    pub fn new(body: Body, limits: UploadLimits) -> Self {
        Self { body, limits, bytes: 0, waited: Duration::ZERO, waits: None }
    }

    fn may_wait(&self) -> Duration {
        may_wait(&self.limits, self.bytes)
    }
}

/// How long a body of which so many bytes came may have waited for its client.
fn may_wait(limits: &UploadLimits, bytes: u64) -> Duration {
    (limits.grace + Duration::from_secs(bytes / limits.least_rate.max(1))).min(limits.time)
}

/// Why a body was given up.
#[derive(Debug, thiserror::Error)]
#[error("it came too slowly: {bytes} bytes in {} s of waiting; the least is {least} bytes a second", waited.as_secs())]
struct TooSlow {
    bytes: u64,
    waited: Duration,
    least: u64,
}

impl HttpBody for PacedBody {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        let this = &mut *self;
        if let Poll::Ready(frame) = Pin::new(&mut this.body).poll_frame(context) {
            if let Some((since, _)) = this.waits.take() {
                this.waited += since.elapsed();
            }
            if let Some(Ok(frame)) = &frame {
                this.bytes += frame.data_ref().map_or(0, |data| data.len() as u64);
            }
            return Poll::Ready(frame);
        }
        let left = this.may_wait().saturating_sub(this.waited);
        let (since, until) = this.waits.get_or_insert_with(|| {
            let now = Instant::now();
            (now, Box::pin(sleep_until(now + left)))
        });
        ready!(until.as_mut().poll(context));
        let waited = this.waited + since.elapsed();
        let error = TooSlow { bytes: this.bytes, waited, least: this.limits.least_rate };
        Poll::Ready(Some(Err(axum::Error::new(error))))
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}

#[cfg(test)]
mod tests {
    use futures::StreamExt as _;
    use futures::stream;

    use super::*;

    fn limits() -> UploadLimits {
        let (grace, time) = (Duration::from_secs(10), Duration::from_secs(100));
        UploadLimits { least_rate: 10, grace, time, bytes_per_token: 0 }
    }

    #[test]
    fn bytes_that_came_allow_further_waiting_up_to_a_time_in_all() {
        let seconds = |bytes| may_wait(&limits(), bytes).as_secs();
        assert_eq!([0, 9, 10, 500, 1000, u64::MAX].map(seconds), [10, 10, 11, 60, 100, 100]);
    }

    /// How many of a body's bytes come, and the error, if each byte is waited for as long as the pause.
    async fn trickled(bytes: usize, pause: Duration, grace: Duration) -> (usize, Option<String>) {
        let body = stream::iter(0..bytes).then(move |_| async move {
            tokio::time::sleep(pause).await;
            Ok::<_, std::convert::Infallible>(Bytes::from_static(b"x"))
        });
        let limits = UploadLimits { grace, least_rate: 1_000_000, ..limits() };
        let mut paced = Body::new(PacedBody::new(Body::from_stream(body), limits)).into_data_stream();
        let mut came = 0;
        while let Some(chunk) = paced.next().await {
            match chunk {
                Ok(_) => came += 1,
                Err(error) => return (came, Some(error.to_string())),
            }
        }
        (came, None)
    }

    #[tokio::test]
    async fn a_trickle_is_given_up_and_a_slow_body_within_its_grace_is_not() {
        // All pauses together are longer than the grace, and none is by itself.
        let (pause, grace) = (Duration::from_millis(20), Duration::from_millis(100));
        let (came, error) = trickled(1000, pause, grace).await;
        assert!(came <= 5, "{came} bytes came in a grace of five pauses");
        assert!(error.unwrap().contains("too slowly: "));
        assert_eq!(trickled(3, pause, Duration::from_secs(100)).await, (3, None));
    }
}
