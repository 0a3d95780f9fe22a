//! Invalid maps.

use std::fs;

use crate::rendering::{mapped, render};

/// Headers that do not match the file, and numbers that are not finite.
#[test]
fn hostile_maps_are_refused() {
    let bench = mapped();
    let good = fs::read(bench.out().join("map.ply")).expect("a map");
    let end = b"end_header\n";
    let body = good
        .windows(end.len())
        .position(|w| w == end)
        .expect("a header")
        + end.len();
    let header = std::str::from_utf8(&good[..body]).expect("text");
    let count = header
        .lines()
        .find(|l| l.starts_with("element vertex"))
        .expect("a count");
    let with = |from: &str, to: &str| {
        assert!(header.contains(from), "no `{from}`");
        [header.replacen(from, to, 1).as_bytes(), &good[body..]].concat()
    };
    let mut not_a_number = good.clone();
    not_a_number[body..body + 4].copy_from_slice(&f32::NAN.to_le_bytes());
    let format = "binary_little_endian";
    let cases = [
        (Vec::new(), &["0 bytes of header"][..]),
        (b"solid cube\n".to_vec(), &["solid cube", "`ply`"]),
        (good[..40].to_vec(), &["expected"]),
        (
            good[..good.len() - 1].to_vec(),
            &["the file ends", "as many numbers"],
        ),
        (
            [&good[..], b"x"].concat(),
            &["bytes after the last element"],
        ),
        (
            with(count, "element vertex 99999999999"),
            &["99999999999", "at most"],
        ),
        (
            with(count, "element vertex 18446744073709551616"),
            &["18446744073709551616"],
        ),
        (with(count, "element vertex -1"), &["-1"]),
        (
            with(count, "element vertex 0"),
            &["bytes after the last element"],
        ),
        (with("float opacity", "float opaqueness"), &["opacity"]),
        (
            with("property float x", "property list uchar int x"),
            &["list x", "a number"],
        ),
        (
            with("property float y", "property float x"),
            &["each property once"],
        ),
        (with(format, "ascii"), &["vertex 0", "ASCII"]),
        (
            with(format, "binary"),
            &["Unknown format: binary", "big_endian"],
        ),
        (not_a_number, &["vertex 0", "is NaN"]),
        (
            [b"ply\ncomment ".to_vec(), vec![b'x'; 1 << 20]].concat(),
            &["expected"],
        ),
    ];
    let map = bench.path("hostile.ply");
    for (bytes, words) in cases {
        fs::write(&map, &bytes).expect("written");
        let answer = render(&map, &bench.path("images"), &["--pose", "0 0 0 0 0 0 1"]);
        let answer = answer.fails_at_last_with(&["hostile.ply: "]);
        answer.fails_with(words);
    }
    assert!(!bench.path("images").exists(), "nothing was drawn");
}
