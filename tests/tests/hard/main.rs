//! Hard cases must stay finite and right.
//!
//! There is one test for every invariant of the table of hard cases. Printed lines begin with the case's
//! number. `cargo test -p forelight-tests --test hard -- --nocapture` prints the worst value and its limit
//! for each. A comment beside each limit justifies it.
//!
//! | cases | subject | file |
//! | --- | --- | --- |
//! | 1, 4, 5, 6 | furnaces, reciprocity, sampling, Fresnel | `materials` |
//! | 4, 5, 6 | the same for scattering functions alone | `scattering` |
//! | 3, 6, 16, 17 | energy balance, form factors, lights, extreme radiance | `lights` |
//! | 7, 8, 9 | scale, place and gaps | `similarity` |
//! | 10 to 13 | closed meshes, degenerate triangles, special rays, coplanar surfaces | `meshes` |
//! | 14 | instances | `instances` |
//! | 2, 18 to 21 | the irradiance cache | `cache`, `shared_cache` |
//! | 15 | dielectrics in dielectrics | `media`, `nested` |
//! | 11, 16, 17 | difficult bundles, through the loader | `bundles` |
//! | 22 to 24, 27 | forecasts | `forecast` |
//! | 25 | plans | `planning` |
//! | 26 | sums | `sums` |
//! | 28 | light by way of small bright places, fine detail | `spots` |
//!
//! `FORELIGHT_HARD_RAYS` sets the number of rays of case 10. The default is one million; the table asks for
//! a hundred million.

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
mod spots;
mod sums;
