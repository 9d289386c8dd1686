//! Deliveries to webhooks.

use forelight_protocol::{WebhookKind, WebhookRequest};

use super::*;
use crate::NewDelivery;

#[tokio::test]
async fn a_receiver_that_is_away_holds_up_no_other() {
    let farm = Farm::new().await;
    let mut webhooks = Vec::new();
    for (name, jobs) in [("away", 1500), ("well", 3)] {
        let request = WebhookRequest {
            url: format!("https://{name}.example/hook"),
            kinds: None,
            project: None,
            template: None,
        };
        let webhook = farm.store.add_webhook(&request, &[WebhookKind::Test], "secret", at(0)).await.unwrap();
        // Of each job two, of which the first is due.
        let of_job = |_| {
            let (event, job, kind) = (None, Some(JobId::new()), WebhookKind::Test);
            [(); 2].map(|()| NewDelivery { event, job, kind, body: "{}".to_owned() })
        };
        let deliveries: Vec<NewDelivery> = (0..jobs).flat_map(of_job).collect();
        farm.store.add_deliveries(webhook.id, &deliveries, None, at(1)).await.unwrap();
        webhooks.push(webhook.id);
    }
    let (due, next) = farm.store.due_deliveries(at(2)).await.unwrap();
    let of = |webhook| due.iter().filter(|delivery| delivery.webhook == webhook).count();
    assert_eq!((of(webhooks[0]), of(webhooks[1]), next), (50, 3, None));
}
