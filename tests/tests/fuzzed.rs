//! Damaged input of every kind: past findings of fuzzing, and a fixed number of mutations of good input.
//!
//! `FORELIGHT_MUTATIONS` sets the number of mutations of each parser's input (default 400). `FORELIGHT_SEEDS`
//! names a folder to write the good input to, as a start for fuzzing: `tests/fuzz/corpus`.

use forelight_random::Random;
use forelight_tests::parsers::{Parser, all};
use forelight_tests::repository;
use serde_json::Value;
use std::panic::{AssertUnwindSafe, catch_unwind};

/// Words that sometimes replace something else.
const WORDS: [&str; 24] = [
    "-1",
    "0",
    "1e39",
    "-1e-45",
    "nan",
    "inf",
    "1e400",
    "4294967295",
    "4294967296",
    "18446744073709551616",
    "-9223372036854775808",
    "null",
    "true",
    "[]",
    "{}",
    "\"\"",
    "../",
    "\n",
    "\r\n",
    "\0",
    "\u{feff}",
    "é",
    ",",
    "0.1.2",
];

/// One to eight changes: bits, bytes, words, four-byte numbers, ranges removed, doubled or moved, an early
/// end.
fn mutated(bytes: &[u8], random: &mut Random) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    for _ in 0..=random.index(8) {
        let at = random.index(bytes.len());
        let length = random.index(16.min(bytes.len() - at + 1));
        match random.index(9) {
            0 if !bytes.is_empty() => bytes[at] ^= 1 << random.index(8),
            1 if !bytes.is_empty() => bytes[at] = random.index(256) as u8,
            2 => {
                bytes.drain(at..at + length);
            }
            3 => {
                let copy = bytes[at..at + length].to_vec();
                let to = random.index(bytes.len() + 1);
                bytes.splice(to..to, copy);
            }
            4 => {
                let word = WORDS[random.index(WORDS.len())];
                bytes.splice(at..at + length, word.bytes());
            }
            // Replace a number with a word.
            5 => {
                let is_number = |b: &u8| b.is_ascii_digit() || matches!(b, b'.' | b'-' | b'e');
                if let Some(start) = bytes[at..].iter().position(is_number).map(|p| at + p) {
                    let end =
                        bytes[start..].iter().position(|b| !is_number(b)).map_or(bytes.len(), |p| start + p);
                    bytes.splice(start..end, WORDS[random.index(11)].bytes());
                }
            }
            6 if at + 4 <= bytes.len() => {
                let extreme = [0u32, 1, 0x7fff_ffff, 0x8000_0000, u32::MAX, 0x7f80_0000, 0x0001_0000];
                bytes[at..at + 4].copy_from_slice(&extreme[random.index(7)].to_le_bytes());
            }
            7 if random.index(4) == 0 => bytes.truncate(at),
            _ if !bytes.is_empty() => bytes[at] = b"0123456789-./ e\n{}[],:\""[random.index(23)],
            _ => {}
        }
    }
    bytes
}

/// Reads the bytes. A panic is repeated with the bytes.
fn read(parser: &Parser, bytes: &[u8], which: &str) {
    if catch_unwind(AssertUnwindSafe(|| (parser.read)(bytes))).is_err() {
        panic!("{} {which}: {:?}", parser.name, String::from_utf8_lossy(bytes));
    }
}

#[test]
fn good_input_of_every_parser_is_read() {
    for parser in all() {
        for (number, seed) in (parser.seeds)().iter().enumerate() {
            read(&parser, seed, "seed");
            if let Some(folder) = std::env::var_os("FORELIGHT_SEEDS") {
                let folder = std::path::Path::new(&folder).join(parser.name);
                std::fs::create_dir_all(&folder).expect("the folder can be made");
                std::fs::write(folder.join(format!("seed-{number}")), seed)
                    .expect("the folder can be written to");
            }
        }
        read(&parser, &[], "nothing");
    }
}

#[test]
fn what_fuzzing_once_found_is_read_or_refused() {
    let folder = repository().join("tests/hard/fuzzed");
    let mut count = 0;
    for parser in all() {
        let Ok(entries) = std::fs::read_dir(folder.join(parser.name)) else { continue };
        for path in entries.map(|entry| entry.expect("the folder can be read").path()) {
            read(&parser, &std::fs::read(&path).expect("the file can be read"), &path.display().to_string());
            count += 1;
        }
    }
    println!("{count} inputs");
}

#[test]
fn mutated_input_of_every_parser_is_read_or_refused() {
    let wanted = std::env::var("FORELIGHT_MUTATIONS").ok().and_then(|n| n.parse().ok());
    let mutations: u64 = wanted.unwrap_or(400);
    for parser in all() {
        let seeds = (parser.seeds)();
        for number in 0..mutations {
            let mut random = Random::new(number);
            let seed = &seeds[random.index(seeds.len())];
            read(&parser, &mutated(seed, &mut random), &format!("mutation {number}"));
        }
    }
}

/// The places of all numbers in a JSON document.
fn numbers(value: &Value, pointer: &str, found: &mut Vec<String>) {
    match value {
        Value::Number(_) => found.push(pointer.to_owned()),
        Value::Array(list) => {
            list.iter().enumerate().for_each(|(i, v)| numbers(v, &format!("{pointer}/{i}"), found));
        }
        Value::Object(map) => map.iter().for_each(|(k, v)| numbers(v, &format!("{pointer}/{k}"), found)),
        _ => {}
    }
}

#[test]
fn any_number_of_a_document_may_be_any_other_number() {
    let others = ["-1", "0", "1", "5", "4294967295", "18446744073709551615", "1e38", "-1e300", "0.5", "null"];
    let mut count = 0;
    for parser in all().filter(|p| ["description", "gltf", "protocol"].contains(&p.name)) {
        for seed in (parser.seeds)() {
            let document: Value = serde_json::from_slice(&seed).expect("the seed is JSON");
            let mut found = Vec::new();
            numbers(&document, "", &mut found);
            for pointer in found {
                for other in others {
                    let mut changed = document.clone();
                    let place = changed.pointer_mut(&pointer).expect("the place was just found");
                    *place = serde_json::from_str(other).expect("a number");
                    read(&parser, changed.to_string().as_bytes(), &format!("{pointer} = {other}"));
                    count += 1;
                }
            }
        }
    }
    assert!(count > 1000, "{count} documents");
}
