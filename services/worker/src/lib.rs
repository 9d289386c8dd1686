//! The worker: leases a task, has a renderer do it, reports the result.
//!
//! It talks to the service by HTTP alone, and knows neither SQL nor how light is traced: whatever implements
//! [`forelight_renderer::Execute`] does the tasks.
//!
//! | file | subject |
//! | --- | --- |
//! | `agent` | the life of a task between lease and result |
//! | `report` | results and errors on their way to the service |
//! | `bundles` | bundles fetched from the service |
//! | `pictures` | pictures of a video, fetched for one task |
//! | `limits` | tasks that exceed their limits |
//! | `machine` | what this machine has |
//! | `errors` | what an error of the service or of a task means for the worker |

mod agent;
mod bundles;
mod errors;
mod limits;
mod machine;
mod pictures;
mod report;

pub use agent::{Agent, AgentError, Errand};
pub use bundles::Bundles;
pub use machine::machine;
