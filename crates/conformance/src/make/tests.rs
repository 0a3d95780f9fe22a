use garad_core::Par;
use garad_golden::judge::judge;
use garad_golden::verdict::Outcome;
use garad_golden::{Case, Class};

use super::*;
use crate::{Width, answer};

fn passes(case: &Case, width: Width) -> Result<(), String> {
    let outputs = answer(case.inputs(), width).unwrap().unwrap();
    let verdict = judge(case, &outputs.answers(), false);
    match verdict.outcome {
        Outcome::Pass => Ok(()),
        _ => Err(garad_golden::report::table(&[verdict])),
    }
}

fn options(kind: SceneKind, gaussians: usize, size: [usize; 2]) -> SceneOptions {
    SceneOptions {
        kind,
        gaussians,
        size,
        degree: 1,
        seed: 3,
    }
}

/// Each scene, forwards and backwards: garad in f64 and in f32 passes, masks say where f32 may differ.
#[test]
fn scenes_are_passed_in_both_widths() {
    let root = tempfile::tempdir().unwrap();
    let mut wrong = Vec::new();
    for (name, kind) in SceneKind::ALL {
        let made = splatting(&options(kind, 400, [80, 64]), Par::Seq).unwrap();
        for made in made {
            let case = Case::load(&made.write(root.path()).unwrap()).unwrap();
            assert!(
                case.inputs().has_flag(FLAG) && case.basis() == BASIS,
                "{name}"
            );
            for width in [Width::F64, Width::F32] {
                if let Err(report) = passes(&case, width) {
                    wrong.push(format!("{name} {width:?}: {report}"));
                }
            }
            if case.stage() == "raster" {
                let share = |mask: &str| {
                    let mask = case.inputs().get(mask).unwrap().i64();
                    mask.iter().sum::<i64>() as f64 / mask.len() as f64
                };
                for mask in ["robust", "robust_radii", "robust_order"] {
                    let share = share(mask);
                    assert!(share > 0.8, "{name}: {mask} {share}");
                }
            } else {
                let class = case.tolerance("d_means").unwrap().class;
                assert!(matches!(class, Class::Rows { .. }), "{name}");
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// Same bytes for any number of threads; another seed is another scene; ties are there.
#[test]
fn cases_depend_on_the_options_alone() {
    let make = |seed, par| {
        let options = SceneOptions {
            seed,
            ..options(SceneKind::Stack, 200, [48, 32])
        };
        splatting(&options, par).unwrap()
    };
    let (one, two, other) = (make(3, Par::Seq), make(3, Par::new(2)), make(4, Par::Seq));
    for k in 0..2 {
        assert_eq!(one[k].inputs, two[k].inputs, "threads");
        assert_eq!(one[k].outputs, two[k].outputs, "threads");
        assert_ne!(one[k].inputs["means"], other[k].inputs["means"], "seed");
    }
    let means = one[0].inputs["means"].f64();
    let mut rows: Vec<Vec<u64>> = means
        .chunks(3)
        .map(|r| r.iter().map(|v| v.to_bits()).collect())
        .collect();
    rows.sort();
    rows.dedup();
    assert!(rows.len() < 200, "equal depths");
    assert!(
        splatting(&options(SceneKind::Room, 0, [48, 32]), Par::Seq).is_err(),
        "nothing"
    );
}

/// Lists beside the case agree with what is judged: `last` counts in them, and keys ascend.
#[test]
fn tile_lists_are_those_of_the_images() {
    let [made, _] = splatting(&options(SceneKind::Room, 300, [49, 35]), Par::Seq).unwrap();
    let input = |name: &str| made.inputs[name].i64();
    let (ranges, entries, keys) = (
        input("tile_ranges"),
        input("tile_entries"),
        input("tile_keys"),
    );
    assert_eq!(ranges.len(), 2 * 4 * 3, "tiles of 16 px");
    assert!(keys.is_sorted(), "tile, then depth");
    assert_eq!(*ranges.last().unwrap(), entries.len() as i64, "all");
    let last = made.outputs["last"].0.i64();
    let radii = made.outputs["radii"].0.i64();
    for (i, &last) in last.iter().enumerate() {
        let tile = i / 49 / 16 * 4 + i % 49 / 16;
        assert!(last <= ranges[2 * tile + 1] - ranges[2 * tile], "pixel {i}");
    }
    assert!(
        entries.iter().all(|&row| radii[row as usize] > 0),
        "visible"
    );
}

/// The stages that are not the rasterizer's, small, in both widths.
#[test]
fn other_stages_are_passed_in_both_widths() {
    let root = tempfile::tempdir().unwrap();
    let mut wrong = Vec::new();
    for (stage, _, most) in Other::stages() {
        let other = Other {
            size: [160, 128],
            count: most.min(300),
            seed: 5,
        };
        let made = other.make(stage, Par::Seq).unwrap();
        let case = Case::load(&made.write(root.path()).unwrap()).unwrap();
        for width in [Width::F64, Width::F32] {
            if let Err(report) = passes(&case, width) {
                wrong.push(format!("{stage} {width:?}: {report}"));
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    let none = Other {
        size: [64; 2],
        count: 9,
        seed: 1,
    };
    assert!(none.make("sh", Par::Seq).is_err(), "not one of them");
}
