//! The right numbers in the wrong places.

use super::suspect::Suspect;

/// Half a pixel is named if undoing it takes at least this share off the error.
const HALF_PIXEL_GAIN: f64 = 0.35;
/// Columns beyond this are not exchanged in pairs.
const MAX_COLUMNS: usize = 16;

/// Tries orders of axes, of components, of rows, and shifts by a pixel.
pub(super) fn find(suspect: &Suspect<'_>) -> Option<String> {
    components(suspect)
        .or_else(|| exchanged(suspect))
        .or_else(|| axes(suspect))
        .or_else(|| rows(suspect))
        .or_else(|| shifts(suspect))
}

/// The last axis: colours, coordinates, quaternions, twists.
fn components(s: &Suspect<'_>) -> Option<String> {
    let n = s.columns();
    let turned = |by: usize| s.gather(|i| i - i % n + (i % n + by) % n);
    match n {
        2 => s.named(
            "the two components are swapped: (row, column) instead of (x, y)?",
            &turned(1),
        ),
        3 => {
            let reversed = s.gather(|i| i - i % 3 + 2 - i % 3);
            s.named(
                "the three components are reversed: BGR instead of RGB?",
                &reversed,
            )
        }
        4 => {
            let conjugate = s.map(|i, g| if i % 4 == 0 { g } else { -g });
            s.named(
                "quaternions are (x, y, z, w) instead of (w, x, y, z)",
                &turned(3),
            )
            .or_else(|| s.named("quaternions were read as (x, y, z, w)", &turned(1)))
            .or_else(|| {
                s.named(
                    "quaternions are conjugated: the inverse rotation",
                    &conjugate,
                )
            })
        }
        6 => s.named(
            "(rotation, translation) instead of (translation, rotation)",
            &turned(3),
        ),
        _ => None,
    }
}

/// Two components of many in each other's place.
fn exchanged(s: &Suspect<'_>) -> Option<String> {
    let n = s.columns();
    if !(3..=MAX_COLUMNS).contains(&n) || s.rows() < 2 {
        return None;
    }
    let pairs = (0..n).flat_map(|a| (a + 1..n).map(move |b| (a, b)));
    pairs.into_iter().find_map(|(a, b)| {
        let swapped = s.gather(|i| match i % n {
            c if c == a => i - a + b,
            c if c == b => i - b + a,
            _ => i,
        });
        s.named(&format!("components {a} and {b} are exchanged"), &swapped)
    })
}

fn axes(s: &Suspect<'_>) -> Option<String> {
    if let [.., a, b] = *s.shape
        && a == b
        && a > 1
    {
        let transposed = s.gather(|i| i - i % (a * b) + (i % b) * b + i / b % a);
        if let Some(name) = s.named(
            "transposed: column-major, or the inverse rotation",
            &transposed,
        ) {
            return Some(name);
        }
    }
    // Fortran order under the right shape: the first index runs fastest.
    let many = s.shape.iter().filter(|&&n| n > 1).count();
    if many > 1 {
        let fortran = s.gather(|mut i| {
            let mut at = vec![0; s.shape.len()];
            for (axis, &n) in s.shape.iter().enumerate().rev() {
                at[axis] = i % n;
                i /= n;
            }
            let steps = at.iter().zip(s.shape).rev();
            steps.fold(0, |flat, (&index, &n)| flat * n + index)
        });
        return s.named(
            "the order of the axes is reversed: column-major data",
            &fortran,
        );
    }
    None
}

fn rows(s: &Suspect<'_>) -> Option<String> {
    let n = s.shape.first().copied().unwrap_or(1);
    if n < 2 {
        return None;
    }
    let width = s.got.len() / n;
    let reversed = s.gather(|i| (n - 1 - i / width) * width + i % width);
    if let Some(name) = s.named(
        "the first axis is reversed: back to front, or upside down",
        &reversed,
    ) {
        return Some(name);
    }
    let sorted = |values: &[f64]| {
        let mut order: Vec<usize> = (0..n).collect();
        let row = |i: usize| &values[i * width..(i + 1) * width];
        order.sort_by(|&a, &b| {
            let pairs = row(a).iter().zip(row(b));
            pairs.fold(std::cmp::Ordering::Equal, |so_far, (x, y)| {
                so_far.then(x.total_cmp(y))
            })
        });
        order
    };
    let (mine, theirs) = (sorted(s.got), sorted(s.expected));
    let mut matched = s.got.to_vec();
    for (&from, &to) in mine.iter().zip(&theirs) {
        matched[to * width..(to + 1) * width]
            .copy_from_slice(&s.got[from * width..(from + 1) * width]);
    }
    s.named("the same rows in another order", &matched)
}

/// Images, as large as the case says or at least 8 x 8, displaced by one pixel.
fn shifts(s: &Suspect<'_>) -> Option<String> {
    let [height, width, ..] = *s.shape else {
        return None;
    };
    if height < 8 || width < 8 {
        return None;
    }
    let channels = s.got.len() / (height * width);
    let flipped = s.gather(|i| {
        let (pixel, k) = (i / channels, i % channels);
        (pixel - pixel % width + width - 1 - pixel % width) * channels + k
    });
    if let Some(name) = s.named("mirrored, left to right", &flipped) {
        return Some(name);
    }
    let moves = [
        (0, 1, "one pixel to the right"),
        (0, -1, "one pixel to the left"),
        (1, 0, "one pixel down"),
        (-1, 0, "one pixel up"),
        (1, 1, "one pixel down and to the right"),
        (-1, -1, "one pixel up and to the left"),
    ];
    // What comes from outside of the image is not judged.
    let moved = |down: isize, right: isize| -> Vec<f64> {
        (0..s.got.len())
            .map(|i| {
                let (y, x) = (i / channels / width, i / channels % width);
                let from = y
                    .checked_add_signed(down)
                    .filter(|&y| y < height)
                    .zip(x.checked_add_signed(right).filter(|&x| x < width));
                from.map_or(s.expected[i], |(y, x)| {
                    s.got[(y * width + x) * channels + i % channels]
                })
            })
            .collect()
    };
    let whole = moves.into_iter().find_map(|(down, right, name)| {
        s.named(&format!("displaced by {name}"), &moved(down, right))
    });
    whole.or_else(|| half_shifts(s, &moved))
}

/// Half a pixel cannot be undone, but the mean of two displaced images comes near.
fn half_shifts(s: &Suspect<'_>, moved: &dyn Fn(isize, isize) -> Vec<f64>) -> Option<String> {
    let error = |numbers: &[f64]| -> f64 {
        let pairs = numbers.iter().zip(s.expected);
        pairs.map(|(a, b)| (a - b) * (a - b)).sum::<f64>().sqrt()
    };
    let mean = |images: &[Vec<f64>]| -> Vec<f64> {
        let n = images.len() as f64;
        (0..s.got.len())
            .map(|i| images.iter().map(|p| p[i]).sum::<f64>() / n)
            .collect()
    };
    let moves = [
        (0, 1, "to the right"),
        (0, -1, "to the left"),
        (1, 0, "down"),
        (-1, 0, "up"),
        (1, 1, "down and to the right"),
        (-1, -1, "up and to the left"),
    ];
    let now = error(s.got);
    let tries = moves.map(|(down, right, name)| {
        let mut corners = vec![moved(0, 0), moved(down, right)];
        if down != 0 && right != 0 {
            corners.extend([moved(down, 0), moved(0, right)]);
        }
        (error(&mean(&corners)), name)
    });
    let best = tries.into_iter().min_by(|a, b| a.0.total_cmp(&b.0))?;
    let near = best.0 < HALF_PIXEL_GAIN * now;
    near.then(|| format!("displaced by about half a pixel {}", best.1))
}
