//! Tests of reading and writing maps.
#![allow(clippy::float_cmp, reason = "maps are read back bit by bit")]

use std::path::Path;

use garad_core::{GaussianMap, KeyframeId, Label, NewGaussian, Rng};

use super::*;
use crate::DatasetError;

/// A map whose numbers are all different.
fn some_map(n: usize, degree: usize) -> GaussianMap<f32> {
    let mut rng = Rng::keyed(3, &[n as u64, degree as u64]);
    let mut map = GaussianMap::<f64>::new(degree);
    for i in 0..n {
        map.push(&NewGaussian {
            mean: [rng.normal(), rng.normal(), rng.normal()],
            sigma_m: rng.range(0.01, 1.0),
            opacity: rng.range(0.05, 0.95),
            color: [0.5; 3],
            landmark: None,
            born: KeyframeId(0),
        });
        map.quaternions[i] = [1.0, rng.normal(), rng.normal(), rng.normal()];
        map.log_scales[i][1] += 0.5;
        map.label[i] = if i % 3 == 1 {
            Label::Dynamic
        } else {
            Label::Static
        };
    }
    for triple in &mut map.sh {
        *triple = [rng.normal(), rng.normal(), rng.normal()];
    }
    map.cast()
}

fn to_bytes(map: &GaussianMap<f32>, label: bool) -> Vec<u8> {
    let mut bytes = Vec::new();
    format_ply(&mut bytes, map, &PlyOptions { label }).expect("memory takes everything");
    bytes
}

fn parse(bytes: &[u8]) -> Result<GaussianMap<f32>, DatasetError> {
    parse_ply(Path::new("map.ply"), &mut &bytes[..])
}

#[test]
fn round_trip() {
    for degree in 0..=3 {
        for label in [false, true] {
            let map = some_map(5, degree);
            let back = parse(&to_bytes(&map, label)).expect("our own");
            assert_eq!(back.sh_degree(), 3, "filled up");
            assert_eq!(back.means, map.means, "means");
            assert_eq!(back.log_scales, map.log_scales, "scales");
            assert_eq!(back.quaternions, map.quaternions, "quaternions");
            assert_eq!(back.opacity_logits, map.opacity_logits, "opacities");
            for i in 0..map.len() {
                let (mine, zeros) = back.sh_of(i).split_at(map.coefficients());
                assert_eq!(mine, map.sh_of(i), "colour of {i}");
                assert!(
                    zeros.iter().flatten().all(|&v| v.to_bits() == 0),
                    "zeros of {i}"
                );
            }
            let labels = if label {
                map.label
            } else {
                vec![Label::Static; 5]
            };
            assert_eq!(back.label, labels, "labels");
            back.validate().expect("consistent");
        }
    }
}

#[test]
fn vertex_is_62_floats_in_the_standard_order() {
    let map = some_map(2, 3);
    let bytes = to_bytes(&map, false);
    let text = String::from_utf8_lossy(&bytes);
    let end = text.find("end_header\n").expect("a header") + "end_header\n".len();
    assert_eq!(
        text[..end].matches("property float ").count(),
        62,
        "62 properties"
    );
    assert_eq!(bytes.len() - end, 2 * 248, "248 bytes each");
    let float = |row: usize, column: usize| {
        let at = end + row * 248 + column * 4;
        f32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]])
    };
    // Columns counted by hand in the published layout.
    let expected = [
        (0, map.means[1][0], "x"),
        (3, 0.0, "nx"),
        (6, map.sh_of(1)[0][0], "f_dc_0 is red"),
        (9, map.sh_of(1)[1][0], "f_rest_0 is red, coefficient 1"),
        (10, map.sh_of(1)[2][0], "f_rest_1 is red, coefficient 2"),
        (24, map.sh_of(1)[1][1], "f_rest_15 is green, coefficient 1"),
        (53, map.sh_of(1)[15][2], "f_rest_44 is blue, coefficient 15"),
        (54, map.opacity_logits[1], "opacity"),
        (55, map.log_scales[1][0], "scale_0"),
        (58, map.quaternions[1][0], "rot_0 is w"),
        (61, map.quaternions[1][3], "rot_3"),
    ];
    for (column, value, name) in expected {
        assert_eq!(float(1, column).to_bits(), value.to_bits(), "{name}");
    }
}

/// The same file in another encoding.
fn recoded(bytes: &[u8], label: bool, encoding: &str) -> Vec<u8> {
    let end = b"end_header\n";
    let start = bytes.windows(end.len()).position(|w| w == end);
    let (header, body) = bytes.split_at(start.expect("a header") + end.len());
    let header = String::from_utf8_lossy(header).replace("binary_little_endian", encoding);
    let mut file = header.into_bytes();
    for vertex in body.chunks(248 + usize::from(label)) {
        let (floats, label) = vertex.split_at(248);
        let floats = floats.as_chunks().0.iter().copied().map(f32::from_le_bytes);
        if encoding == "ascii" {
            let labels = label.iter().map(u8::to_string);
            let numbers: Vec<String> = floats.map(|v| v.to_string()).chain(labels).collect();
            file.extend((numbers.join(" ") + "\r\n").bytes());
        } else {
            file.extend(floats.flat_map(f32::to_be_bytes));
            file.extend(label);
        }
    }
    file
}

#[test]
fn encodings_hold_the_same_map() {
    for label in [false, true] {
        let bytes = to_bytes(&some_map(4, 3), label);
        let map = parse(&bytes).expect("our own");
        let (text, big_endian) = (
            recoded(&bytes, label, "ascii"),
            recoded(&bytes, label, "binary_big_endian"),
        );
        assert_eq!(parse(&text).expect("text"), map, "text");
        assert_eq!(
            parse(text.trim_ascii_end()).expect("text"),
            map,
            "no last newline"
        );
        assert_eq!(parse(&big_endian).expect("big endian"), map, "big endian");
        for (file, expected) in [(&text, "bytes after"), (&big_endian, "bytes after")] {
            let longer = [&file[..], b"\n1"].concat();
            let message = parse(&longer).expect_err("too long").to_string();
            assert!(message.contains(expected), "{message}");
        }
        // A number may lose digits unnoticed, but no number may be missing.
        let last = text.iter().rposition(|&b| b == b' ').expect("a space");
        for cut in 0..=last {
            assert!(parse(&text[..cut]).is_err(), "text cut after {cut} bytes");
        }
    }
}

#[test]
fn an_empty_map_is_a_map() {
    let back = parse(&to_bytes(&GaussianMap::new(0), true)).expect("no vertex");
    assert!(back.is_empty(), "none");
}

#[test]
fn writing_refuses_numbers_that_are_not_finite() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let path = folder.path().join("map.ply");
    let mut map = some_map(3, 0);
    write_ply(&path, &map, &PlyOptions::default()).expect("fine");
    assert_eq!(read_ply(&path).expect("there").len(), 3, "read back");
    map.opacity_logits[2] = f32::NAN;
    let message = write_ply(&path, &map, &PlyOptions::default())
        .expect_err("NaN")
        .to_string();
    assert!(message.contains("Gaussian 2"), "{message}");
    assert_eq!(
        read_ply(&path).expect("still there").len(),
        3,
        "the old file stays"
    );
}

/// A header for `n` vertices of degree `degree` and the bytes of as many.
fn foreign(n: usize, degree: usize) -> (String, Vec<u8>) {
    let rest = 3 * ((degree + 1) * (degree + 1) - 1);
    // Another order of properties, one that means nothing to us, and types of other width.
    let mut header = format!(
        "ply\r\nformat binary_little_endian 1.0\r\ncomment of others\r\nelement vertex {n}\r\n\
         property double weight\r\nproperty float rot_0\r\nproperty float rot_1\r\n\
         property float rot_2\r\nproperty float rot_3\r\n"
    );
    let names = ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity"];
    let scales = ["scale_0", "scale_1", "scale_2"];
    for name in names.iter().chain(&scales) {
        header += &format!("property float32 {name}\r\n");
    }
    for i in 0..rest {
        header += &format!("property float f_rest_{i}\r\n");
    }
    header += "property uchar class\r\nend_header\r\n";
    let mut body = Vec::new();
    for _ in 0..n {
        body.extend(9.0f64.to_le_bytes());
        for i in 0..14 + u16::try_from(rest).expect("small") {
            body.extend((f32::from(i) + 1.0).to_le_bytes());
        }
        body.push(7);
    }
    (header, body)
}

#[test]
fn foreign_files_are_read_by_property_name() {
    for degree in 0..=3 {
        let (header, body) = foreign(2, degree);
        let map = parse(&[header.as_bytes(), &body].concat()).expect("ordinary");
        assert_eq!((map.len(), map.sh_degree()), (2, degree), "size");
        assert_eq!(
            map.quaternions[1],
            [1.0, 2.0, 3.0, 4.0],
            "rot comes first there"
        );
        assert_eq!(map.means[0], [5.0, 6.0, 7.0], "then x y z");
        assert_eq!(map.log_scales[0], [12.0, 13.0, 14.0], "scales");
        if degree > 0 {
            let k = f32::from(u8::try_from(map.coefficients() - 1).expect("small"));
            assert_eq!(
                map.sh_of(0)[1],
                [15.0, 15.0 + k, 15.0 + 2.0 * k],
                "channel-major"
            );
        }
    }
}

#[test]
fn hostile_headers_are_refused() {
    let (header, body) = foreign(2, 0);
    let change = |from: &str, to: &str| {
        assert!(header.contains(from), "the header has {from}");
        [header.replacen(from, to, 1).as_bytes(), &body].concat()
    };
    let cases: Vec<(&str, Vec<u8>, &str)> = vec![
        ("empty", Vec::new(), "ply"),
        ("no magic", b"obj\n".to_vec(), "\"obj\""),
        (
            "text format",
            change("binary_little_endian", "ascii"),
            "ASCII",
        ),
        ("other format", change("little", "middle"), "middle"),
        ("other version", change("1.0", "2.0"), "2.0"),
        ("format missing", change("format", "comment"), "format"),
        (
            "no vertex",
            change("element vertex", "element face"),
            "face",
        ),
        ("count too small", change("vertex 2", "vertex 1"), "bytes"),
        (
            "count too large",
            change("vertex 2", "vertex 3"),
            "vertex 2: the file ends",
        ),
        (
            "count above the cap",
            change("vertex 2", "vertex 16000001"),
            "16000001",
        ),
        (
            "huge count",
            change("vertex 2", "vertex 4000000000"),
            "4000000000",
        ),
        (
            "endless count",
            change("vertex 2", "vertex 99999999999999999999"),
            "999",
        ),
        ("negative count", change("vertex 2", "vertex -2"), "-2"),
        (
            "lists of 7",
            change("uchar class", "list uchar int faces"),
            "the file ends",
        ),
        ("unknown type", change("uchar class", "quad class"), "quad"),
        (
            "twice",
            change("property float rot_1", "property float rot_0"),
            "rot_0",
        ),
        (
            "missing",
            change("float32 opacity", "float32 opaque"),
            "opacity",
        ),
        ("no end", change("end_header", "end"), "end"),
        (
            "rows without properties",
            change("end_header", "element face 9\r\nend_header"),
            "face",
        ),
        (
            "second count",
            change("end_header", "element vertex 2\r\nend_header"),
            "vertex",
        ),
        (
            "odd number of f_rest",
            change("uchar class", "char f_rest_0"),
            "f_rest",
        ),
        (
            "no property at all",
            b"ply\nformat binary_little_endian 1.0\nelement vertex 2000000\nend_header\n".to_vec(),
            "x",
        ),
        (
            "endless header",
            [
                b"ply\nformat binary_little_endian 1.0\n".to_vec(),
                vec![b'c'; 1 << 20],
            ]
            .concat(),
            "header",
        ),
    ];
    for (name, bytes, expected) in cases {
        let message = parse(&bytes).expect_err(name).to_string();
        assert!(
            message.starts_with("map.ply: ") && message.contains(expected),
            "{name}: {message}"
        );
        assert!(!message.contains('\n'), "{name}: one line: {message}");
    }
    for cut in 0..header.len() + body.len() {
        let whole = [header.as_bytes(), &body].concat();
        assert!(parse(&whole[..cut]).is_err(), "cut after {cut} bytes");
    }
}

/// An ASCII file with these properties and one row.
fn one(properties: &str, row: &str) -> Vec<u8> {
    let properties = properties.split_whitespace();
    let lines: String = properties
        .map(|name| format!("property float {name}\n"))
        .collect();
    format!("ply\nformat ascii 1.0\nelement vertex 1\n{lines}end_header\n{row}\n").into_bytes()
}

const PLAIN: &str =
    "x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3";
const ROW: [&str; 14] = [
    "1", "2", "3", "0.1", "0.2", "0.3", "0.5", "-3", "-4", "-5", "1", "0", "0.5", "0",
];

/// The row with another value of one property.
fn changed(name: &str, value: &str) -> Vec<u8> {
    let mut row = ROW;
    let at = PLAIN
        .split(' ')
        .position(|n| n == name)
        .expect("a property");
    row[at] = value;
    one(PLAIN, &row.join(" "))
}

#[test]
fn every_number_that_cannot_be_used_is_named() {
    for name in PLAIN.split(' ') {
        let message = parse(&changed(name, "nan")).expect_err(name).to_string();
        let expected = format!("map.ply: vertex 0: property {name} is NaN");
        assert!(message.starts_with(&expected), "{message}");
    }
    for (name, value, good) in [
        ("x", "inf", false),
        ("f_dc_1", "-inf", false),
        ("scale_0", "inf", false),
        ("scale_0", "18", false),
        ("scale_0", "17.9", true),
        ("scale_1", "-200", true),
        ("rot_3", "1e39", false), // beyond f32
        ("rot_3", "1e38", true),
        ("z", "1e30", true),
    ] {
        let read = parse(&changed(name, value));
        assert_eq!(read.is_ok(), good, "{name} = {value}: {read:?}");
    }
}

#[test]
fn what_other_programs_write() {
    let of = |properties: &str, row: &str| parse(&one(properties, row)).expect(properties);
    let opacity = |value: &str| {
        parse(&changed("opacity", value))
            .expect(value)
            .opacity_logits[0]
    };
    assert_eq!(
        [opacity("inf"), opacity("-inf")],
        [40.0, -40.0],
        "opaque and invisible"
    );
    let flat = parse(&changed("scale_2", "-inf")).expect("flat");
    assert_eq!(flat.log_scales[0], [-3.0, -4.0, -16.0], "no extent");
    let rest = "x y z f_dc_0 f_dc_1 f_dc_2 opacity rot_0 rot_1 rot_2 rot_3";
    let disc = of(
        &format!("scale_0 scale_1 {rest}"),
        "-3 -4 1 2 3 0.1 0.2 0.3 0.5 1 0 0.5 0",
    );
    assert_eq!(
        disc.log_scales[0],
        [-3.0, -4.0, -16.0],
        "2D Gaussian Splatting"
    );
    let sphere = of(
        &format!("scale_0 {rest}"),
        "-3 1 2 3 0.1 0.2 0.3 0.5 1 0 0.5 0",
    );
    assert_eq!(sphere.log_scales[0], [-3.0; 3], "a sphere");
    assert_eq!(sphere.quaternions[0], [1.0, 0.0, 0.5, 0.0], "as written");
    let long = parse(&changed("rot_1", "-4e25")).expect("long").quaternions[0];
    assert_eq!(long, [2.5e-26, -1.0, 1.25e-26, 0.0], "normalised");
    let rgb = PLAIN.replace("f_dc_0 f_dc_1 f_dc_2", "red green blue");
    let row = "1 2 3 0.5 1 0 0.5 -3 -4 -5 1 0 0.5 0";
    let half = 0.5 / 0.282_094_8;
    let colors = of(&rgb, row).sh[0];
    for (color, expected) in colors.into_iter().zip([0.0, half, -half]) {
        assert!((color - expected).abs() < 1e-6, "{colors:?}");
    }
    let bytes =
        String::from_utf8(one(&rgb, &row.replacen("0.5 1 0", "51 255 0", 1))).expect("text");
    let bytes = ["red", "green", "blue"].iter().fold(bytes, |text, name| {
        text.replace(&format!("float {name}"), &format!("uchar {name}"))
    });
    let red = parse(bytes.as_bytes()).expect("bytes").sh[0][0];
    assert!((red - (0.2 - 0.5) / 0.282_094_8).abs() < 1e-6, "{red}");
    let more = of(
        &format!("{PLAIN} segment f_rest_mask"),
        &format!("{} 7 8", ROW.join(" ")),
    );
    assert_eq!(more.sh_degree(), 0, "f_rest_mask is no coefficient");
}

#[test]
fn other_elements_are_skipped() {
    let (header, body) = foreign(2, 0);
    let map = parse(&[header.as_bytes(), &body].concat()).expect("plain");
    let camera = "element camera 1\r\nproperty double focal\r\nproperty int id\r\nelement vertex";
    let faces = "element face 2\r\nproperty list uchar int vertex_indices\r\nend_header";
    let header = header
        .replacen("element vertex", camera, 1)
        .replacen("end_header", faces, 1);
    let mut file = header.into_bytes();
    file.extend(525f64.to_le_bytes());
    file.extend(3i32.to_le_bytes());
    file.extend(&body);
    file.extend([2, 0, 0, 0, 0, 1, 0, 0, 0, 0]); // one face of two, one of none
    assert_eq!(parse(&file).expect("with others"), map, "same Gaussians");
    file.push(b'\n');
    assert_eq!(parse(&file).expect("a last newline"), map, "same Gaussians");
    file.pop();
    file.pop();
    let message = parse(&file).expect_err("cut").to_string();
    assert!(message.contains("face 1: the file ends"), "{message}");
}

/// Positions lie between 0 and 2047, 1023, 2047, so that they are the packed numbers.
#[test]
fn compressed_files_are_unpacked() {
    let floats = |names: &[&str]| -> String {
        names
            .iter()
            .map(|name| format!("property float {name}\n"))
            .collect()
    };
    let bounds = [
        "min_x",
        "min_y",
        "min_z",
        "max_x",
        "max_y",
        "max_z",
        "min_scale_x",
        "min_scale_y",
        "min_scale_z",
        "max_scale_x",
        "max_scale_y",
        "max_scale_z",
    ];
    let header = format!(
        "ply\nformat ascii 1.0\nelement chunk 1\n{}element vertex 2\nproperty uint packed_position\n\
         property uint packed_rotation\nproperty uint packed_scale\nproperty uint packed_color\nelement sh 2\n{}end_header\n",
        floats(&bounds),
        (0..9)
            .map(|i| format!("property uchar f_rest_{i}\n"))
            .collect::<String>()
    );
    let position = (5u32 << 21) | (6 << 11) | 7;
    let scale = (2047u32 << 21) | 2047;
    // The largest is y; w is 1/sqrt 2, x and z are nearly 0.
    let rotation = (2u32 << 30) | (1023 << 20) | (511 << 10) | 512;
    let color = (255u32 << 24) | (51 << 8) | 255;
    let file = format!(
        "{header}0 0 0 2047 1023 2047 -8 -7 -6 -4 -3 -2\n{position} {rotation} {scale} {color}\n0 0 0 0\n\
         0 255 128 1 2 3 4 5 6\n0 0 0 0 0 0 0 0 0\n"
    );
    let map = parse(file.as_bytes()).expect("compressed");
    let near = |a: &[f32], b: &[f32]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-3);
    assert_eq!((map.len(), map.sh_degree()), (2, 1), "size");
    assert!(near(&map.means[0], &[5.0, 6.0, 7.0]), "{:?}", map.means[0]);
    assert!(
        near(&map.log_scales[0], &[-4.0, -7.0, -2.0]),
        "{:?}",
        map.log_scales[0]
    );
    let half = 0.5f32.sqrt();
    assert!(
        near(&map.quaternions[0], &[half, 0.0, half, 0.0]),
        "{:?}",
        map.quaternions[0]
    );
    let unit = 0.5 / 0.282_095;
    assert!(
        near(&map.sh_of(0)[0], &[unit, -unit, -0.6 * unit]),
        "{:?}",
        map.sh_of(0)
    );
    assert_eq!(
        [map.opacity_logits[0], map.opacity_logits[1]],
        [40.0, -40.0],
        "opacity"
    );
    // Channel by channel: f_rest_0, 3 and 6 are coefficient 1 of red, green, blue.
    let value = |v: f32| ((v + 0.5) / 256.0 - 0.5) * 8.0;
    assert!(
        near(&map.sh_of(0)[1], &[-4.0, value(1.0), value(4.0)]),
        "{:?}",
        map.sh_of(0)
    );
    assert!(
        near(&map.sh_of(0)[2], &[4.0, value(2.0), value(5.0)]),
        "{:?}",
        map.sh_of(0)
    );
    map.validate().expect("sound");
    let message =
        parse(file.replace("element chunk", "element lump").as_bytes()).expect_err("no chunk");
    assert!(
        message.to_string().contains("no element chunk"),
        "{message}"
    );
}

#[test]
fn bad_vertices_are_reported() {
    let (header, body) = foreign(2, 0);
    let stride = body.len() / 2;
    let with = |column: usize, value: f32| {
        let mut body = body.clone();
        let at = stride + 8 + 4 * column;
        body[at..at + 4].copy_from_slice(&value.to_le_bytes());
        parse(&[header.as_bytes(), &body].concat())
    };
    let message = with(5, f32::NAN).expect_err("NaN").to_string();
    assert!(message.contains("vertex 1"), "{message}");
    let mut zero = body.clone();
    zero[8..24].fill(0);
    let message = parse(&[header.as_bytes(), &zero].concat())
        .expect_err("zero quaternion")
        .to_string();
    assert!(message.contains("vertex 0"), "{message}");
    let mut labelled = to_bytes(&some_map(2, 0), true);
    *labelled.last_mut().expect("not empty") = 2;
    let message = parse(&labelled).expect_err("label 2").to_string();
    assert!(
        message.contains("vertex 1") && message.contains('2'),
        "{message}"
    );
}

/// A damaged file gives a map or an error, never a panic.
#[test]
fn damaged_files_do_not_panic() {
    let (header, body) = foreign(3, 1);
    let good = [
        to_bytes(&some_map(3, 2), true),
        [header.as_bytes(), &body].concat(),
    ];
    let mut refused = 0;
    for case in 0..4000u64 {
        let mut rng = Rng::keyed(17, &[case]);
        let mut bytes = good[rng.below(2)].clone();
        crate::damage::damage(&mut bytes, &mut rng);
        match parse(&bytes) {
            Ok(map) => map.validate().expect("what is read is sound"),
            Err(_) => refused += 1,
        }
    }
    assert!(
        refused > 1000,
        "damage is noticed, {refused} of 4000 refused"
    );
}

/// A NaN or an infinity in each column of each vertex is reported with vertex and property; normals and
/// what others add are not read.
#[test]
fn numbers_that_are_not_finite_are_named() {
    let (header, body) = foreign(3, 2);
    let stride = body.len() / 3;
    let names = header.lines().filter_map(|line| {
        let rest = line.trim_end().strip_prefix("property float")?;
        rest.rsplit(' ').next().map(str::to_owned)
    });
    let names: Vec<String> = names.collect();
    assert_eq!(names.len(), 14 + 24, "rot, x to scale, f_rest");
    for vertex in [0, 2] {
        for (column, name) in names.iter().enumerate() {
            for (value, word) in [(f32::NAN, "NaN"), (f32::NEG_INFINITY, "-inf")] {
                let mut spoilt = body.clone();
                let at = vertex * stride + 8 + 4 * column;
                spoilt[at..at + 4].copy_from_slice(&value.to_le_bytes());
                let message = parse(&[header.as_bytes(), &spoilt].concat());
                let defined = word == "-inf" && (name == "opacity" || name.starts_with("scale_"));
                if defined {
                    message.expect("invisible or flat");
                    continue;
                }
                let message = message.expect_err("not finite").to_string();
                let expected = format!("vertex {vertex}: property {name} is {word};");
                assert!(message.contains(&expected), "{expected}: {message}");
            }
        }
    }
    let mut bytes = to_bytes(&some_map(2, 3), true);
    let end = bytes.len() - 2 * 249;
    for normal in 3..6 {
        let at = end + 249 + 4 * normal;
        bytes[at..at + 4].copy_from_slice(&f32::NAN.to_le_bytes());
    }
    assert_eq!(
        parse(&bytes).expect("normals are not read").len(),
        2,
        "normals"
    );
    let text = recoded(&to_bytes(&some_map(1, 0), false), false, "ascii");
    let start = text.iter().rposition(|&b| b == b' ').expect("a space");
    let large = [&text[..start], b" 1e99\r\n"].concat();
    let message = parse(&large).expect_err("beyond f32").to_string();
    assert!(
        message.contains("vertex 0: property rot_3 is inf"),
        "{message}"
    );
}
