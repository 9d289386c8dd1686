//! Decisions, as pure functions: no SQL, no async, no clock. Transactions read what a decision needs, call
//! it, and write what it says.
//!
//! | module | decides |
//! | --- | --- |
//! | `availability` | when a node is awake, and when it counts as silent |
//! | `budgets` | which action spending calls for, and what running frames still commit |
//! | `evidence` | which results are possible |
//! | `faults` | whose fault a failure is, and when a node is set aside |
//! | `learning` | what finished frames and jobs teach about nodes and quotes |
//! | `nodes` | which state a node is in, and which of its changes call for a new plan |
//! | `overdue` | which running tasks are late, stalled or over, and when they end |
//! | `projection` | when open bookings end, from now on |
//! | `rebooking` | which bookings a job has after a new plan, and what is said of its promise |
//! | `replans` | which causes of a new plan are kept |
//! | `retries` | when a failed task is tried again, and when it fails its job |
//! | `shared_cache` | how many rounds fill a shared cache, and what follows each |
//! | `unattended` | why no node works on new quotes |
//! | `versions` | which version of our own renderer renders a job |
//! | `work_stealing` | which booked tasks an idle node may take |

pub(crate) mod availability;
pub(crate) mod budgets;
pub(crate) mod evidence;
pub(crate) mod faults;
pub(crate) mod learning;
pub(crate) mod nodes;
pub(crate) mod overdue;
pub(crate) mod projection;
pub(crate) mod rebooking;
pub(crate) mod replans;
pub(crate) mod retention;
pub(crate) mod retries;
pub(crate) mod shared_cache;
pub(crate) mod unattended;
pub(crate) mod versions;
pub(crate) mod work_stealing;
