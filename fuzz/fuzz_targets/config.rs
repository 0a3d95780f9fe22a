//! A layer of `config.toml` over the defaults: what was read is the same when written and read again.

#![no_main]

use garad::config_file::{Layer, layered, write};
use garad_fuzz::{check_line, within_mib};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|text: &str| {
    let read = |text: &str| {
        let (name, text) = ("config.toml".to_owned(), text.to_owned());
        within_mib(32, || layered(&[Layer { name, text }]))
    };
    let config = match read(text) {
        Ok(config) => config,
        Err(error) => return check_line(&format!("{error:#}"), "config.toml:"),
    };
    let again = read(&write(&config).expect("TOML")).expect("what was written");
    assert_eq!(again, config, "round trip");
});
