//! Damage at random places: any outcome but a panic is right, and every error is one line.

use crate::made::{Files, MTL, OBJ, triangle_bin, triangle_glb, triangle_gltf};
use crate::made::{load_zip, zip};
use forelight_random::Random;
use forelight_scene::{Limits, Scene, SceneError};
use serde_json::Value;
use std::collections::BTreeMap;

/// Changes, removes or doubles a few bytes.
fn damage(bytes: &[u8], random: &mut Random) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    for _ in 0..=random.index(3) {
        let at = random.index(bytes.len());
        match random.index(4) {
            0 => bytes[at] = random.index(256) as u8,
            1 => bytes[at] = b"0123456789-./ e\n"[random.index(16)],
            2 => {
                bytes.remove(at);
            }
            _ => bytes.insert(at, bytes[at]),
        }
    }
    bytes
}

fn survives(result: Result<Scene, SceneError>) {
    match result {
        Ok(scene) => {
            for frame in [0, scene.frame_count() / 2, scene.frame_count() - 1] {
                let _ = scene.frame(frame);
            }
        }
        Err(error) => assert!(!error.to_string().contains('\n'), "{error:?}"),
    }
}

#[test]
fn damaged_text_never_ends_the_program() {
    let good = Files::good()
        .with(
            "scene.mtl",
            format!("{MTL}Ks 0.1 0.2 0.3\nNi 1.5\nPr 0.3\nillum 2\nKe 1 2 3\nTf 1 1 1\nd 0.5\n"),
        )
        .with("scene.obj", format!("{OBJ}o other\nf -4 -3 -2\nf 1//1 2//1 3//1\n"));
    for seed in 0..1500 {
        let mut random = Random::new(seed);
        let name = ["scene.obj", "scene.mtl", "scene.json"][random.index(3)];
        survives(good.clone().with(name, damage(&good.0[name], &mut random)).load());
    }
}

#[test]
fn damaged_gltf_files_never_end_the_program() {
    let (binary, text) = (triangle_glb(), triangle_gltf().to_string());
    for seed in 0..1500 {
        let mut random = Random::new(seed);
        let files = Files(BTreeMap::new());
        let files = match random.index(2) {
            0 => files.with("a.glb", damage(&binary, &mut random)),
            _ => files.with("a.gltf", damage(text.as_bytes(), &mut random)).with("tri.bin", triangle_bin()),
        };
        survives(files.load());
    }
}

#[test]
fn any_number_of_a_gltf_file_may_be_any_other_number() {
    fn numbers(value: &Value, pointer: &str, found: &mut Vec<String>) {
        match value {
            Value::Number(_) => found.push(pointer.to_owned()),
            Value::Array(a) => {
                a.iter().enumerate().for_each(|(i, v)| numbers(v, &format!("{pointer}/{i}"), found))
            }
            Value::Object(o) => o.iter().for_each(|(k, v)| numbers(v, &format!("{pointer}/{k}"), found)),
            _ => {}
        }
    }
    let document = triangle_gltf();
    let mut found = Vec::new();
    numbers(&document, "", &mut found);
    assert!(found.len() > 30);
    for pointer in found {
        for value in
            ["-1", "0", "1", "7", "4294967295", "18446744073709551615", "1e38", "-1e300", "0.5", "null"]
        {
            let mut changed = document.clone();
            *changed.pointer_mut(&pointer).unwrap() = serde_json::from_str(value).unwrap();
            survives(crate::made::gltf(&changed, &triangle_bin()).load());
        }
    }
}

#[test]
fn damaged_archives_never_end_the_program() {
    let good = Files::good();
    let entries: Vec<(&str, &[u8])> = good.0.iter().map(|(p, c)| (p.as_str(), c.as_slice())).collect();
    let archive = zip(&entries);
    assert!(load_zip(&archive, &Limits::default()).is_ok());
    for seed in 0..1500 {
        survives(load_zip(&damage(&archive, &mut Random::new(seed)), &Limits::default()));
    }
}
