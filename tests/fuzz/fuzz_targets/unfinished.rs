#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| forelight_fuzz::parsers::unfinished(bytes));
