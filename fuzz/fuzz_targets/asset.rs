#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| prelight_tests::fuzzed::asset(bytes));
