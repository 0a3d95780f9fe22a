//! Adam against its moments in closed form (`tests/golden/gen/adam.py`).

use garad_golden::Case;
use garad_optim::{Adam, AdamConfig};

/// Every number of the case, NaN while its row does not exist.
fn path(case: &Case) -> Vec<f64> {
    let start = case.input("start").f64();
    let n = start.len();
    let gradients = case.input("gradients").f64();
    let rates = case.input("learning_rates").f64();
    let config = AdamConfig {
        beta1: case.param_f64("beta1"),
        beta2: case.param_f64("beta2"),
        eps: case.param_f64("eps"),
    };
    let kept = case.try_input("kept").map(|t| t.u8().to_vec());
    let old = kept.as_ref().map_or(n, Vec::len);
    let mut adam = Adam::new(config, old, 1).expect("valid");
    // Which numbers of the case the rows are, and their values.
    let mut rows: Vec<usize> = (0..old).collect();
    let mut values = start[..old].to_vec();
    let mut path = Vec::new();
    for (t, gradient) in gradients.chunks(n).enumerate() {
        if let Some(kept) = kept
            .as_ref()
            .filter(|_| t == case.param_usize("change_after"))
        {
            let keep: Vec<bool> = kept.iter().map(|&k| k == 1).collect();
            adam.retain(&keep).expect("as many rows");
            adam.extend(n - old);
            rows = (0..n).filter(|&i| i >= old || keep[i]).collect();
            let last = path[path.len() - n..].to_vec();
            values = rows
                .iter()
                .map(|&i| if i < old { last[i] } else { start[i] })
                .collect();
        }
        let part: Vec<f64> = rows.iter().map(|&i| gradient[i]).collect();
        adam.step(&mut values, &part, rates[t]).expect("a step");
        let mut all = vec![f64::NAN; n];
        for (&i, &value) in rows.iter().zip(&values) {
            all[i] = value;
        }
        path.extend(all);
    }
    path
}

#[test]
fn paths_are_the_closed_form() {
    for case in Case::load_all("adam") {
        case.check("path", &path(&case))
            .unwrap_or_else(|report| panic!("{report}"));
    }
}
