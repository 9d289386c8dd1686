//! Frames, track record, dashboard.

use forelight_protocol::{FrameState, NodeState, QuantileHits};

use super::*;

#[tokio::test]
async fn a_frame_row_holds_forecast_booking_actual_and_error() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let job = farm.booked_job(request("4,8"), node.id, at(10)).await;
    let lease = farm.claim(node.id, at(12)).await.unwrap();
    farm.commit(&lease, at(19)).await;
    let rows = farm.store.frames(job, None, 10).await.unwrap();
    assert_eq!(rows.iter().map(|row| row.frame).collect::<Vec<_>>(), [4, 8]);
    assert_eq!(farm.store.frames(job, Some(4), 10).await.unwrap(), rows[1..]);
    let done = &rows[0];
    let booked = done.booked.as_ref().unwrap();
    assert_eq!((booked.node.as_str(), booked.start, booked.end), ("a", at(10), at(20)));
    assert_eq!((done.state, done.started, done.finished), (FrameState::Done, Some(at(12)), Some(at(19))));
    let work = done.work.unwrap();
    assert_eq!(
        (work.forecast.mean, work.actual, work.error),
        (900.0, Some(1000.0), Some(900.0 / 1000.0 - 1.0))
    );
    // Two CPU seconds on a node of speed 2 are four on a node of speed 1.
    assert_eq!(done.cpu_seconds.unwrap().actual, Some(4.0));
    assert!(done.artifacts.image_exr.is_some() && done.artifacts.preview_png.is_some());
    assert_eq!((rows[1].state, rows[1].work.unwrap().actual), (FrameState::Ready, None));
}

#[tokio::test]
async fn the_track_record_counts_hits_of_each_quantile() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let job = farm.booked_job(request("0-2"), node.id, at(10)).await;
    assert_eq!(farm.store.track_record(None, 10, None).await.unwrap().work_mean_absolute_error, None);
    for work in [900, 1000, 1200] {
        let lease = farm.claim(node.id, at(12)).await.unwrap();
        let TaskResult::Render(mut render) = farm.result_for(&lease).await else { panic!() };
        render.stats.work = work;
        let now = at(20 + i64::from(render.stats.frame));
        farm.store
            .commit_result(lease.lease_id, lease.fence, &TaskResult::Render(render), now)
            .await
            .unwrap();
    }
    let record = farm.store.track_record(None, 2, None).await.unwrap();
    assert_eq!((record.frames, record.work_hits), (3, QuantileHits { p50: 1, p80: 2, p95: 2 }));
    assert_eq!(record.cpu_hits, QuantileHits { p50: 0, p80: 0, p95: 3 });
    let error = record.work_mean_absolute_error.unwrap();
    assert!((error - (0.0 + 0.1 + 0.25) / 3.0).abs() < 1e-12, "{error}");
    assert!((record.work_bias.unwrap() - (2700.0 / 3100.0 - 1.0)).abs() < 1e-12);
    assert_eq!(record.items.iter().map(|row| row.frame).collect::<Vec<_>>(), [2, 1]);
    let last = &record.items[1];
    let next = farm.store.track_record(Some((last.finished, job, last.frame)), 2, None).await.unwrap();
    assert_eq!(next.items.iter().map(|row| row.frame).collect::<Vec<_>>(), [0]);
}

#[tokio::test]
async fn the_dashboard_shows_what_every_node_does_and_which_are_silent() {
    let farm = Farm::new().await;
    let (a, b) = (farm.node("a").await, farm.node("b").await);
    let job = farm.booked_job(request("0-3"), a.id, at(100)).await;
    let lease = farm.claim(a.id, at(100)).await.unwrap();
    farm.store.renew(lease.lease_id, &renewal(lease.fence, 0.5), TTL, at(105)).await.unwrap();
    let dashboard = farm.dashboard(at(105)).await;
    assert_eq!(
        (dashboard.counts.jobs_active, dashboard.counts.nodes, dashboard.counts.nodes_alive),
        (1, 2, 1)
    );
    assert_eq!(
        (dashboard.counts.tasks.leased, dashboard.counts.tasks.ready, dashboard.counts.tasks.done),
        (1, 3, 2)
    );
    let shown = &dashboard.jobs[0];
    assert_eq!((shown.id, shown.progress, shown.eta), (job, 0.125, Some(at(140))));
    // A silent node needs somebody, so it comes first.
    let [second, first] = &dashboard.nodes[..] else { panic!() };
    assert_eq!((first.id, first.alive, second.id, second.alive), (a.id, true, b.id, false));
    let activity = first.activity.as_ref().unwrap();
    assert_eq!((activity.frame, activity.progress, activity.started), (Some(0), 0.5, at(100)));
    assert_eq!(second.activity, None);
    assert_eq!((first.state, second.state), (NodeState::Working, NodeState::Silent));
    assert_eq!((dashboard.node_counts.working, dashboard.node_counts.silent), (1, 1));
    assert_eq!((dashboard.counts.jobs.rendering, dashboard.jobs_open_total), (1, 1));
    assert_eq!(dashboard.bookings.iter().map(|booking| booking.frame).collect::<Vec<_>>(), [1, 2, 3]);
    assert_eq!(dashboard.last_event_id, farm.store.last_event_id().await.unwrap());
}
