//! A frame that several nodes render: where its parts end, the pixels of one part, and the image that is put
//! together from them. Image, counters and work are those of a frame that is rendered in one piece.
//!
//! | file | subject |
//! | --- | --- |
//! | `cost_map` | what pixels will cost, from a few camera samples, and so where parts end |
//! | `caches` | its irradiance cache on the way from task to task |
//! | `part` | the pixels of one part |
//! | `passes` | a frame whose samples go where they help: files between passes, parts of a pass |
//! | `whole` | the image, put together |

mod caches;
mod cost_map;
mod part;
pub(crate) mod passes;
mod whole;

pub use cost_map::Divided;
pub use part::colors_of_part;
