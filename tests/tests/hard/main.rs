//! The hard cases stay finite, and right.
//!
//! One test for every invariant of the table of hard cases; the number in a printed line is the case's. A run
//! with `cargo test -p forelight-tests --test hard -- --nocapture` prints for each the worst value seen and
//! its limit; what the limit rests on stands in the test, beside it.
//!
//! | cases | subject | file |
//! | --- | --- | --- |
//! | 1, 4, 5, 6 | furnaces, reciprocity, sampling, Fresnel | `materials` |
//! | 4, 5, 6 | the same of scattering functions by themselves | `scattering` |
//! | 3, 6, 16, 17 | energy balance, form factors, lights, extreme radiance | `lights` |
//! | 7, 8, 9 | scale, place and gaps | `similarity` |
//! | 10 to 13 | closed meshes, degenerate triangles, special rays, coplanar surfaces | `meshes` |
//! | 14 | instances | `instances` |
//! | 2, 18 to 21 | the irradiance cache | `cache`, `shared_cache` |
//! | 15 | dielectrics in dielectrics | `media` |
//! | 11, 16, 17 | nasty bundles, through the loader | `bundles` |
//! | 22 to 24, 27 | forecasts | `forecast` |
//! | 25 | plans | `planning` |
//! | 26 | sums | `sums` |
//!
//! `FORELIGHT_HARD_RAYS` sets the number of rays of case 10 (default four million; the table asks for a
//! hundred million).

mod bundles;
mod cache;
mod forecast;
mod instances;
mod lights;
mod materials;
mod media;
mod meshes;
mod nested;
mod planning;
mod scattering;
mod shared_cache;
mod similarity;
mod sums;
