//! Writes the two shipped scenes to `deploy/scenes`, or to the folder named on the command line:
//!
//! ```sh
//! cargo run -p forelight-scene --example ship_scenes
//! ```

mod generate;

use std::path::{Path, PathBuf};
use std::{env, fs, io};

fn main() -> io::Result<()> {
    let shipped = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../deploy/scenes");
    let root = env::args_os().nth(1).map_or(shipped, PathBuf::from);
    for scene in generate::scenes() {
        let folder = root.join(scene.name);
        for file in scene.files() {
            let path = folder.join(&file.path);
            if let Some(parent) = path.parent() {
                fs::create_dir_all(parent)?;
            }
            fs::write(&path, &file.contents)?;
        }
        println!(
            "{}: {} objects, {} triangles, {}",
            scene.name,
            scene.objects.len(),
            scene.triangle_count(),
            folder.display()
        );
    }
    Ok(())
}
