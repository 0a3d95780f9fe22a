//! Published trajectory errors: Tables I, II and III of the paper.

use garad_eval::{Figures, Row};

/// Where the figures come from.
pub const SOURCE: &str = "Tables I and II of GARAD-SLAM (arXiv 2502.03228)";

const SYSTEMS: [&str; 6] = [
    "ORB-SLAM3",
    "Photo-SLAM",
    "SplaTAM",
    "DDN-SLAM",
    "NID-SLAM",
    "GARAD-SLAM",
];

/// ATE RMSE and STD of each system on a sequence, metres.
type Sequence = (&'static str, [[f64; 2]; SYSTEMS.len()]);

/// Tracking failed.
const X: [f64; 2] = [f64::NAN; 2];

/// TUM, `rgbd_dataset_freiburg3_` in front.
#[rustfmt::skip]
const TUM: [Sequence; 8] = [
    ("walking_xyz", [[0.3623, 0.1855], [0.2862, 0.1591], [0.4216, 0.2538], [0.0140, 0.0085], [0.0623, 0.0372], [0.0155, 0.0080]]),
    ("walking_xyz_validation", [[0.6514, 0.4354], [0.6041, 0.4025], [0.8798, 0.7954], [0.0132, 0.0063], [0.0471, 0.0146], [0.0129, 0.0057]]),
    ("walking_static", [[0.1500, 0.0850], [0.1127, 0.0209], [0.4612, 0.2883], [0.0100, 0.0052], [0.0581, 0.0368], [0.0061, 0.0027]]),
    ("walking_static_validation", [[0.2856, 0.0605], [0.2762, 0.0615], [0.7418, 0.4571], [0.0113, 0.0076], [0.0230, 0.0089], [0.0104, 0.0081]]),
    ("walking_rpy", [[0.6058, 0.2781], [0.5782, 0.2687], X, [0.0390, 0.0252], [0.6080, 0.4107], [0.0360, 0.0224]]),
    ("walking_rpy_validation", [[0.3331, 0.1769], [0.3258, 0.1698], X, [0.0291, 0.0176], X, [0.0280, 0.0184]]),
    ("walking_halfsphere", [[0.2291, 0.1013], [0.2051, 0.1201], [0.7321, 0.6127], [0.0230, 0.0132], [0.6080, 0.4107], [0.0229, 0.0124]]),
    ("walking_halfsphere_validation", [[0.3236, 0.1820], [0.3458, 0.2048], [1.1425, 1.0410], [0.0243, 0.0157], [0.0821, 0.0477], [0.0236, 0.0139]]),
];

/// BONN, `rgbd_bonn_` in front.
#[rustfmt::skip]
const BONN: [Sequence; 8] = [
    ("crowd", [[0.4244, 0.3035], [0.4568, 0.3514], [1.945, 1.182], [0.0180, 0.0108], [0.1804, 0.1021], [0.0182, 0.0091]]),
    ("crowd2", [[0.9257, 0.5681], [0.9425, 0.5735], [3.582, 1.9664], [0.0230, 0.0114], [0.3701, 0.2559], [0.0244, 0.0123]]),
    ("person_tracking", [[0.6176, 0.3291], [0.5715, 0.2912], [0.2598, 0.2883], [0.0430, 0.0171], [0.1002, 0.0612], [0.0462, 0.0150]]),
    ("person_tracking2", [[0.6724, 0.3254], [0.6518, 0.3073], [0.5117, 0.4571], [0.0380, 0.0130], [0.1473, 0.0988], [0.0387, 0.0133]]),
    ("synchronous", [[0.7824, 0.4365], [0.8071, 0.4536], X, [0.0398, 0.0267], X, [0.0248, 0.0207]]),
    ("synchronous2", [[1.3425, 0.4865], [1.3229, 0.4695], X, [0.0194, 0.0128], X, [0.0069, 0.0038]]),
    ("balloon", [[0.0592, 0.0418], [0.0340, 0.0166], [2.4199, 1.0138], [0.0180, 0.0094], [0.0355, 0.0186], [0.0296, 0.0119]]),
    ("balloon2", [[0.2030, 0.1377], [0.2369, 0.0735], [1.3569, 0.0724], [0.0410, 0.0267], [0.0304, 0.0177], [0.0254, 0.0118]]),
];

/// The published figures of a recording, recognised by its name; numbers at its end, which name an excerpt
/// (`bonn_crowd_130_419`), do not matter.
#[must_use]
pub fn rows(recording: &str) -> Option<Vec<Row>> {
    let name = recording.to_lowercase().replace('-', "_");
    let name = name.strip_prefix("rgbd_").unwrap_or(&name);
    let name = name.strip_prefix("dataset_").unwrap_or(name);
    let of = |prefix: &str, table: &'static [Sequence]| {
        let name = name.strip_prefix(prefix)?;
        table
            .iter()
            .find(|(sequence, _)| is_or_is_part_of(name, sequence))
    };
    let (_, figures) = of("bonn_", &BONN)
        .or_else(|| of("freiburg3_", &TUM))
        .or_else(|| of("fr3_", &TUM))?;
    Some(
        SYSTEMS
            .iter()
            .zip(figures)
            .map(|(system, ate)| row(system, *ate))
            .collect(),
    )
}

/// Where the averages of [`ablation_rows`] come from.
pub const ABLATION_SOURCE: &str = "Table III of GARAD-SLAM (arXiv 2502.03228)";

/// Table III: ATE RMSE and STD, metres, the means over the eight sequences of TUM and of BONN. The whole system is
/// headed "w/o Full" there.
#[rustfmt::skip]
#[allow(clippy::approx_constant, reason = "0.3183 as printed, not 1 / pi")]
const ABLATION: [(&str, [[f64; 2]; 2]); 4] = [
    ("GARAD-SLAM", [[0.0194, 0.0114], [0.0267, 0.0122]]),
    ("w/o CRF", [[0.3418, 0.1759], [0.6287, 0.3183]]),
    ("w/o Flow", [[0.0232, 0.0154], [0.0306, 0.0156]]),
    ("w/o Mapping", [[0.0212, 0.0125], [0.0274, 0.0127]]),
];

/// The published averages of the whole system and of it without each part.
#[must_use]
pub fn ablation_rows() -> Vec<Row> {
    let of_part = |(name, figures): (&'static str, [[f64; 2]; 2])| {
        let recordings = ["TUM", "BONN"].into_iter().zip(figures);
        recordings.map(move |(of, ate)| row(&format!("{name}, mean of {of}"), ate))
    };
    ABLATION.into_iter().flat_map(of_part).collect()
}

/// Whether a name is that of the sequence, with numbers behind it or none.
fn is_or_is_part_of(name: &str, sequence: &str) -> bool {
    let rest = name.strip_prefix(sequence);
    let is_number = |part: &str| part.chars().all(|c| c.is_ascii_digit());
    rest.is_some_and(|rest| {
        rest.is_empty() || rest.starts_with('_') && rest.split('_').all(is_number)
    })
}

fn row(system: &str, [rmse_m, std_m]: [f64; 2]) -> Row {
    if rmse_m.is_nan() {
        return Row::failed(system, "tracking failed");
    }
    Row {
        name: system.to_owned(),
        figures: Figures {
            ate_rmse_m: Some(rmse_m),
            ate_std_m: Some(std_m),
            ..Figures::default()
        },
        remark: String::new(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn garad(recording: &str) -> Option<f64> {
        rows(recording)?.last()?.figures.ate_rmse_m
    }

    #[test]
    fn recordings_are_recognised_by_name() {
        assert_eq!(garad("rgbd_bonn_crowd"), Some(0.0182), "whole");
        assert_eq!(garad("bonn_crowd_130_419"), Some(0.0182), "an excerpt");
        assert_eq!(garad("rgbd_bonn_crowd2"), Some(0.0244), "another one");
        let tum = "rgbd_dataset_freiburg3_walking_xyz";
        assert_eq!(garad(tum), Some(0.0155), "TUM");
        assert_eq!(
            garad(&format!("{tum}_validation")),
            Some(0.0129),
            "its second part"
        );
        for other in [
            "rgbd_bonn_crowd3",
            "rgbd_bonn_balloon_tracking",
            "walking",
            "crowd",
            "bonn",
        ] {
            assert_eq!(rows(other), None, "{other}");
        }
    }

    /// Table III against Tables I and II: the whole system has their means, without the field it is Photo-SLAM.
    #[test]
    fn the_ablation_has_the_means_of_the_other_tables() {
        let rows = ablation_rows();
        assert_eq!(rows.len(), 8, "{rows:?}");
        let mean = |table: &[Sequence], system: usize, k: usize| {
            table.iter().map(|(_, f)| f[system][k]).sum::<f64>() / 8.0
        };
        let rmse = |i: usize| rows[i].figures.ate_rmse_m.expect("published");
        for (i, name, of_tables) in [
            (0, "GARAD-SLAM, mean of TUM", mean(&TUM, 5, 0)),
            (1, "GARAD-SLAM, mean of BONN", mean(&BONN, 5, 0)),
            (2, "w/o CRF, mean of TUM", mean(&TUM, 1, 0)),
        ] {
            assert_eq!(rows[i].name, name, "row {i}");
            assert!((rmse(i) - of_tables).abs() < 2e-4, "{name}: {of_tables}");
        }
        let std_m = rows[7].figures.ate_std_m;
        assert_eq!((rmse(7), std_m), (0.0274, Some(0.0127)), "{:?}", rows[7]);
    }

    /// The averages below the paper's tables, which count a failure as 0.
    #[test]
    fn columns_have_the_printed_means() {
        let tum = [0.3676, 0.3418, 0.5474, 0.0205, 0.1861, 0.0194];
        let bonn = [0.6284, 0.6279, 1.2594, 0.0300, 0.1080, 0.0268];
        for (table, printed) in [(&TUM, tum), (&BONN, bonn)] {
            for (k, printed) in printed.into_iter().enumerate() {
                let known = table.iter().map(|(_, figures)| figures[k][0]);
                let mean = known.filter(|v| !v.is_nan()).sum::<f64>() / 8.0;
                assert!((mean - printed).abs() < 6e-5, "{}: {mean}", SYSTEMS[k]);
            }
        }
    }
}
