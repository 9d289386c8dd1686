//! Identifiers. Each kind of thing has its own type.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;
use uuid::Uuid;

macro_rules! id {
    ($(#[$doc:meta])* $name:ident) => {
        $(#[$doc])*
        #[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, Serialize, Deserialize, ToSchema)]
        #[serde(transparent)]
        #[schema(value_type = Uuid)]
        pub struct $name(pub Uuid);

        impl $name {
            /// A new id: a UUID of version 7, so later ids sort later.
            pub fn new() -> Self {
                Self(Uuid::now_v7())
            }
        }

        impl Default for $name {
            fn default() -> Self {
                Self::new()
            }
        }

        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                self.0.hyphenated().fmt(f)
            }
        }

        impl FromStr for $name {
            type Err = uuid::Error;

            fn from_str(text: &str) -> Result<Self, Self::Err> {
                text.parse().map(Self)
            }
        }
    };
}

id!(
    /// Id of a job: frames of one bundle, rendered with the same settings.
    JobId
);
id!(
    /// Id of a task: one part of a job's work.
    TaskId
);
id!(
    /// Id of a lease: a worker's hold on a task.
    LeaseId
);
id!(
    /// Id of a node: a machine with a speed and a price.
    NodeId
);
id!(
    /// Id of a scene bundle.
    BundleId
);
id!(
    /// Id of a plan. Plans never change; a new plan refers to its parent.
    PlanId
);
id!(
    /// Id of a booking: a node that is reserved for a frame for a period of time.
    BookingId
);
id!(
    /// Id of a session: a person who has signed in with a browser.
    SessionId
);
id!(
    /// Id of a bearer token. It is no secret.
    TokenId
);
id!(
    /// Id of a webhook: an address that is told of events.
    WebhookId
);
id!(
    /// Id of a delivery: an event that a webhook is told of.
    DeliveryId
);

/// Position of an event in the farm's order of events. Later events have greater numbers, with possible gaps.
pub type EventId = i64;
