//! Threads that give way to those that answer workers.
//!
//! A plan of a large farm, and the documents that people look at, take seconds of computing. Workers send
//! hundreds of heartbeats a second meanwhile, and on a small machine all of them want the same few cores. So
//! everything that no worker waits for runs on threads of its own, and the system gives those what is left.

use std::sync::Arc;

use axum::extract::{Request, State};
use axum::middleware::Next;
use axum::response::{IntoResponse as _, Response};
use forelight_protocol::ProblemKind;
use tokio::runtime::{Builder, Handle, Runtime};
use tokio_util::task::AbortOnDropHandle;
use tracing::Instrument as _;

use crate::error::ApiError;

/// How nice these threads are. Beside a busy thread of normal priority, one gets a quarter of a core. On a
/// machine that renders as well, quotes and pages need that much.
#[cfg(target_os = "linux")]
const NICE: i32 = 5;

/// The threads. They end when the last clone is dropped.
#[derive(Clone)]
pub(crate) struct LowPriority {
    handle: Handle,
    _threads: Arc<Threads>,
}

/// `None` only while it is dropped.
struct Threads(Option<Runtime>);

impl LowPriority {
    /// Starts the threads: as many as there are cores, and more for what blocks.
    pub fn start() -> std::io::Result<Self> {
        let mut threads = Builder::new_multi_thread();
        let runtime = threads.enable_all().thread_name("low-priority").on_thread_start(give_way).build()?;
        let handle = runtime.handle().clone();
        Ok(Self { handle, _threads: Arc::new(Threads(Some(runtime))) })
    }

    /// The handle by which tasks are started on them. Threads that these start give way as well.
    pub fn handle(&self) -> Handle {
        self.handle.clone()
    }
}

impl Drop for Threads {
    fn drop(&mut self) {
        if let Some(runtime) = self.0.take() {
            // Waiting for the threads is not allowed where tasks run.
            runtime.shutdown_background();
        }
    }
}

/// Elsewhere, priorities belong to whole processes.
#[cfg(not(target_os = "linux"))]
fn give_way() {}

#[cfg(target_os = "linux")]
fn give_way() {
    // Lowering the own priority is always allowed, unless a sandbox forbids the call. It works without.
    let _ = rustix::process::setpriority_process(None, NICE);
}

/// Answers a request on these threads.
pub(crate) async fn answer(State(threads): State<Handle>, request: Request, next: Next) -> Response {
    let answering = threads.spawn(next.run(request).in_current_span());
    match AbortOnDropHandle::new(answering).await {
        Ok(response) => response,
        Err(error) => match error.try_into_panic() {
            Ok(panic) => std::panic::resume_unwind(panic),
            Err(_) => ApiError::new(ProblemKind::Busy, "the service is stopping").into_response(),
        },
    }
}

#[cfg(test)]
mod tests {
    use axum::Router;
    use axum::body::Body;
    use axum::http::StatusCode;
    use axum::middleware::from_fn_with_state;
    use axum::routing::get;
    use tokio::sync::oneshot;
    use tower::ServiceExt as _;
    use tower_http::catch_panic::CatchPanicLayer;

    use super::*;

    fn router(threads: &LowPriority, routes: Router) -> Router {
        routes.layer(from_fn_with_state(threads.handle(), answer)).layer(CatchPanicLayer::new())
    }

    fn asked() -> Request {
        Request::new(Body::empty())
    }

    #[cfg(target_os = "linux")]
    #[tokio::test]
    async fn these_threads_and_those_that_they_start_give_way_and_no_others_do() {
        let nice = || rustix::process::getpriority_process(None).unwrap();
        let own = nice();
        let threads = LowPriority::start().unwrap();
        let (task, blocking, started) = threads
            .handle()
            .spawn(async move {
                let blocking = tokio::task::spawn_blocking(nice).await.unwrap();
                (nice(), blocking, std::thread::spawn(nice).join().unwrap())
            })
            .await
            .unwrap();
        assert_eq!([task, blocking, started], [NICE; 3]);
        assert_eq!(nice(), own);
    }

    #[tokio::test]
    async fn a_panic_harms_one_request_and_an_answer_that_nobody_waits_for_is_given_up() {
        let threads = LowPriority::start().unwrap();
        let panics = get(async || -> StatusCode { panic!("on purpose") });
        let routes = router(&threads, Router::new().route("/", panics));
        let answer = routes.oneshot(asked()).await.unwrap();
        assert_eq!(answer.status(), StatusCode::INTERNAL_SERVER_ERROR);

        let (held, given_up) = oneshot::channel::<()>();
        let held = Arc::new(parking_lot::Mutex::new(Some(held)));
        let waits = get(async move || {
            let _held = held.lock().take();
            std::future::pending::<StatusCode>().await
        });
        let routes = router(&threads, Router::new().route("/", waits));
        let waited =
            tokio::time::timeout(std::time::Duration::from_millis(50), routes.oneshot(asked())).await;
        assert!(waited.is_err());
        assert!(given_up.await.is_err(), "it was dropped");
    }
}
