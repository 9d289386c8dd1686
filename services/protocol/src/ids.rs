//! Identifiers: one type for each kind of thing, so that a lease cannot be passed where a task is meant.

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
            /// A new id (UUID version 7: ids made later sort later).
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
    /// A job: frames of one bundle at one quality.
    JobId
);
id!(
    /// A task: one piece of a job's work.
    TaskId
);
id!(
    /// A worker's hold on a task.
    LeaseId
);
id!(
    /// A node: a machine with a speed and a price.
    NodeId
);
id!(
    /// A scene bundle.
    BundleId
);
id!(
    /// A plan. Plans never change; a new one names its parent.
    PlanId
);
id!(
    /// A node reserved for a frame from one instant to another.
    BookingId
);

/// The place of an event in the farm's one event order: grows by at least one from event to event.
pub type EventId = i64;
