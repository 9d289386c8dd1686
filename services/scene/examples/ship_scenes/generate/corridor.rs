//! The corridor.
use super::bundle::Scene;
/// scene
pub fn scene() -> Scene { super::kitchen::scene() }
