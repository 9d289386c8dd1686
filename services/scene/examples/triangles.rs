//! Prints the triangles of a bundle's frame, one a line, for comparison with other programs:
//!
//! ```sh
//! cargo run -p forelight-scene --example triangles -- BUNDLE [FRAME]
//! ```
//!
//! Columns are separated by tabs: object, material, 9 coordinates, 9 components of normals (0 0 0 where there
//! is none), 6 texture coordinates.

use forelight_scene::{Limits, Scene};
use std::io::{BufWriter, Write, stdout};
use std::path::Path;
use std::{env, error, process};

fn main() -> Result<(), Box<dyn error::Error>> {
    let arguments: Vec<String> = env::args().skip(1).collect();
    let (bundle, number) = match arguments.as_slice() {
        [bundle] => (bundle, 0),
        [bundle, frame] => (bundle, frame.parse()?),
        _ => {
            eprintln!("usage: triangles BUNDLE [FRAME]");
            process::exit(2);
        }
    };
    let frame = Scene::load(Path::new(bundle), &Limits::default())?.frame(number)?;
    let geometry = &frame.geometry;
    let mut out = BufWriter::new(stdout().lock());
    for triangle in 0..geometry.triangles.len() as u32 {
        let object = &geometry.strata.objects[geometry.object(triangle) as usize];
        let material = &frame.materials[geometry.material(triangle) as usize].name;
        write!(out, "{object}\t{material}")?;
        let vectors = [geometry.corners(triangle), geometry.at_corners(triangle, &geometry.normals)];
        for number in vectors.as_flattened().iter().flat_map(|vector| vector.to_array()) {
            write!(out, "\t{number:e}")?;
        }
        for number in geometry.at_corners(triangle, &geometry.uvs).iter().flat_map(|uv| uv.to_array()) {
            write!(out, "\t{number:e}")?;
        }
        writeln!(out)?;
    }
    Ok(())
}
