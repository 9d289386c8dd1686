use super::picture::Picture;

/// A finished image and its cost.
pub struct Rendered {
    pub picture: Picture,
    pub work: u64,
    pub plan: u64,
    pub fill: u64,
    pub records: Vec<u64>,
    pub cpu_seconds: f64,
    pub wall_seconds: f64,
}
