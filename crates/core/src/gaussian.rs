//! [`GaussianMap`]: the map, as a structure of arrays.

use serde::{Deserialize, Serialize};

use crate::Real;
use crate::ids::{KeyframeId, Label, LandmarkId};
use crate::sh::coefficients;

/// A map of 3-D Gaussians. Row i of every array belongs to Gaussian i.
///
/// | array | meaning | activation in use |
/// |---|---|---|
/// | `means` | centre in the world, metres | none |
/// | `log_scales` | ln of the standard deviation along each own axis, ln(metres) | exp |
/// | `quaternions` | (w, x, y, z), world from own axes | normalised |
/// | `opacity_logits` | | sigmoid |
/// | `sh` | [`GaussianMap::coefficients`] triples (r, g, b) per Gaussian | `sh::color` |
///
/// and per Gaussian the landmark it is tagged with, its parent, the keyframe that made it, and its
/// label.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct GaussianMap<T = f32> {
    sh_degree: usize,
    /// Centres in the world, metres.
    pub means: Vec<[T; 3]>,
    /// ln of the standard deviations along the own axes.
    pub log_scales: Vec<[T; 3]>,
    /// Orientation (w, x, y, z) of the own axes in the world, any length but 0.
    pub quaternions: Vec<[T; 4]>,
    /// Opacity before the sigmoid.
    pub opacity_logits: Vec<T>,
    /// Spherical harmonics, `coefficients()` triples per Gaussian.
    pub sh: Vec<[T; 3]>,
    /// The landmark of a tagged Gaussian.
    pub landmark: Vec<Option<LandmarkId>>,
    /// The Gaussian it was cloned or split from.
    pub parent: Vec<Option<u32>>,
    /// The keyframe that made it.
    pub born: Vec<KeyframeId>,
    /// Static or dynamic.
    pub label: Vec<Label>,
}

/// What is needed to add one Gaussian.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NewGaussian<T = f32> {
    /// Centre in the world, metres.
    pub mean: [T; 3],
    /// Standard deviation, the same in every direction, metres.
    pub sigma_m: T,
    /// Opacity in (0, 1).
    pub opacity: T,
    /// Colour in [0, 1], the same from everywhere.
    pub color: [T; 3],
    /// The landmark it is tagged with, if any.
    pub landmark: Option<LandmarkId>,
    /// The keyframe that makes it.
    pub born: KeyframeId,
}

impl<T: Real> GaussianMap<T> {
    /// An empty map whose colours have this degree (0..=3; more is cut to 3).
    #[must_use]
    pub fn new(sh_degree: usize) -> Self {
        Self {
            sh_degree: sh_degree.min(crate::sh::MAX_DEGREE),
            means: Vec::new(),
            log_scales: Vec::new(),
            quaternions: Vec::new(),
            opacity_logits: Vec::new(),
            sh: Vec::new(),
            landmark: Vec::new(),
            parent: Vec::new(),
            born: Vec::new(),
            label: Vec::new(),
        }
    }

    /// Number of Gaussians.
    #[inline]
    #[must_use]
    pub fn len(&self) -> usize {
        self.means.len()
    }

    /// No Gaussian at all.
    #[inline]
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.means.is_empty()
    }

    /// Degree of the spherical harmonics.
    #[inline]
    #[must_use]
    pub fn sh_degree(&self) -> usize {
        self.sh_degree
    }

    /// SH triples per Gaussian, (degree + 1)².
    #[inline]
    #[must_use]
    pub fn coefficients(&self) -> usize {
        coefficients(self.sh_degree)
    }

    /// The SH triples of Gaussian i.
    #[inline]
    #[must_use]
    pub fn sh_of(&self, i: usize) -> &[[T; 3]] {
        let k = self.coefficients();
        &self.sh[i * k..(i + 1) * k]
    }

    /// Adds one round Gaussian and returns its index.
    pub fn push(&mut self, new: &NewGaussian<T>) -> usize {
        let index = self.len();
        let logit = (new.opacity / (T::ONE - new.opacity)).ln();
        self.means.push(new.mean);
        self.log_scales.push([new.sigma_m.ln(); 3]);
        self.quaternions.push([T::ONE, T::ZERO, T::ZERO, T::ZERO]);
        self.opacity_logits.push(logit);
        self.sh.push(new.color.map(crate::sh::dc_from_color));
        self.sh
            .resize((index + 1) * self.coefficients(), [T::ZERO; 3]);
        self.landmark.push(new.landmark);
        self.parent.push(None);
        self.born.push(new.born);
        self.label.push(Label::Static);
        index
    }

    /// Adds a copy of Gaussian i, with i as its parent, and returns its index. The copy has no
    /// landmark of its own; its label is that of the parent.
    pub fn push_copy(&mut self, i: usize) -> usize {
        let index = self.len();
        let k = self.coefficients();
        self.means.push(self.means[i]);
        self.log_scales.push(self.log_scales[i]);
        self.quaternions.push(self.quaternions[i]);
        self.opacity_logits.push(self.opacity_logits[i]);
        self.sh.extend_from_within(i * k..(i + 1) * k);
        self.landmark.push(None);
        self.parent.push(u32::try_from(i).ok());
        self.born.push(self.born[i]);
        self.label.push(self.label[i]);
        index
    }

    /// Raises the degree of the colours (3 at most); the new coefficients are 0, so that no colour
    /// changes. A degree no higher than before changes nothing.
    pub fn raise_sh_degree(&mut self, degree: usize) {
        let degree = degree.min(crate::sh::MAX_DEGREE);
        if degree <= self.sh_degree {
            return;
        }
        let (before, after) = (self.coefficients(), coefficients(degree));
        let mut sh = Vec::with_capacity(self.len() * after);
        for row in self.sh.chunks_exact(before) {
            sh.extend_from_slice(row);
            sh.resize(sh.len() + after - before, [T::ZERO; 3]);
        }
        self.sh = sh;
        self.sh_degree = degree;
    }

    /// Keeps the Gaussians that `keep` names, in their order. Parents are rows of the old map and
    /// are dropped.
    pub fn retain(&mut self, keep: impl Fn(usize) -> bool) {
        let kept: Vec<usize> = (0..self.len()).filter(|&i| keep(i)).collect();
        let k = self.coefficients();
        self.means = kept.iter().map(|&i| self.means[i]).collect();
        self.log_scales = kept.iter().map(|&i| self.log_scales[i]).collect();
        self.quaternions = kept.iter().map(|&i| self.quaternions[i]).collect();
        self.opacity_logits = kept.iter().map(|&i| self.opacity_logits[i]).collect();
        self.sh = kept
            .iter()
            .flat_map(|&i| self.sh[i * k..(i + 1) * k].iter().copied())
            .collect();
        self.landmark = kept.iter().map(|&i| self.landmark[i]).collect();
        self.parent = vec![None; kept.len()];
        self.born = kept.iter().map(|&i| self.born[i]).collect();
        self.label = kept.iter().map(|&i| self.label[i]).collect();
    }

    /// Every array has `len()` rows and every number is finite; stages check this in debug
    /// builds.
    ///
    /// # Errors
    /// A sentence with array and row of the first violation.
    pub fn validate(&self) -> Result<(), String> {
        let n = self.len();
        let lengths = [
            ("log_scales", self.log_scales.len()),
            ("quaternions", self.quaternions.len()),
            ("opacity_logits", self.opacity_logits.len()),
            ("landmark", self.landmark.len()),
            ("parent", self.parent.len()),
            ("born", self.born.len()),
            ("label", self.label.len()),
        ];
        for (name, len) in lengths {
            if len != n {
                return Err(format!("{name} has {len} rows, means has {n}"));
            }
        }
        if self.sh.len() != n * self.coefficients() {
            return Err(format!(
                "sh has {} triples for {n} Gaussians",
                self.sh.len()
            ));
        }
        for i in 0..n {
            let finite = self.means[i].iter().all(|v| v.is_finite())
                && self.log_scales[i].iter().all(|v| v.is_finite())
                && self.quaternions[i].iter().all(|v| v.is_finite())
                && self.opacity_logits[i].is_finite()
                && self.sh_of(i).iter().flatten().all(|v| v.is_finite());
            if !finite {
                return Err(format!("Gaussian {i} has a number that is not finite"));
            }
        }
        Ok(())
    }

    /// The same map in another width, for example f64 to prove gradients.
    #[must_use]
    pub fn cast<U: Real>(&self) -> GaussianMap<U> {
        let to = |v: T| U::from_f64(v.to_f64());
        GaussianMap {
            sh_degree: self.sh_degree,
            means: self.means.iter().map(|v| v.map(to)).collect(),
            log_scales: self.log_scales.iter().map(|v| v.map(to)).collect(),
            quaternions: self.quaternions.iter().map(|v| v.map(to)).collect(),
            opacity_logits: self.opacity_logits.iter().map(|v| to(*v)).collect(),
            sh: self.sh.iter().map(|v| v.map(to)).collect(),
            landmark: self.landmark.clone(),
            parent: self.parent.clone(),
            born: self.born.clone(),
            label: self.label.clone(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn one() -> NewGaussian<f64> {
        NewGaussian {
            mean: [1.0, 2.0, 3.0],
            sigma_m: 0.5,
            opacity: 0.1,
            color: [0.2, 0.5, 0.9],
            landmark: Some(LandmarkId(4)),
            born: KeyframeId(2),
        }
    }

    #[test]
    fn push_stores_what_the_activations_give_back() {
        let mut map = GaussianMap::<f64>::new(3);
        assert_eq!(map.push(&one()), 0, "first index");
        map.validate().expect("consistent");
        assert_eq!(map.sh_of(0).len(), 16, "degree 3");
        let sigmoid = 1.0 / (1.0 + Real::exp(-map.opacity_logits[0]));
        assert!((sigmoid - 0.1).abs() < 1e-15, "opacity {sigmoid}");
        assert!(
            (Real::exp(map.log_scales[0][1]) - 0.5).abs() < 1e-15,
            "scale"
        );
        let color = crate::sh::color(3, map.sh_of(0), [0.0, 0.0, 1.0]);
        assert!((color[2] - 0.9).abs() < 1e-15, "colour {color:?}");
    }

    #[test]
    fn retain_keeps_rows_together() {
        let mut map = GaussianMap::<f64>::new(1);
        for i in 0..4u32 {
            let mut new = one();
            new.mean[0] = f64::from(i);
            new.color[0] = 0.1 * f64::from(i);
            new.born = KeyframeId(i);
            map.push(&new);
        }
        map.retain(|i| i % 2 == 1);
        map.validate().expect("consistent");
        assert_eq!(map.born, [KeyframeId(1), KeyframeId(3)], "in their order");
        assert!((map.means[1][0] - 3.0).abs() < 1e-15, "mean of the last");
        let color = crate::sh::color(1, map.sh_of(1), [0.0, 0.0, 1.0]);
        assert!((color[0] - 0.3).abs() < 1e-15, "colour of the last");
    }

    #[test]
    fn a_copy_is_the_parent_without_its_landmark() {
        let mut map = GaussianMap::<f64>::new(1);
        map.push(&one());
        map.label[0] = Label::Dynamic;
        map.sh[2] = [0.5; 3];
        assert_eq!(map.push_copy(0), 1, "appended");
        map.validate().expect("consistent");
        assert_eq!(map.sh_of(1), map.sh_of(0), "colour");
        assert_eq!(
            (map.parent[1], map.landmark[1], map.label[1]),
            (Some(0), None, Label::Dynamic),
            "parent, landmark, label"
        );
    }

    #[test]
    fn a_higher_degree_changes_no_colour() {
        let mut map = GaussianMap::<f64>::new(0);
        map.push(&one());
        map.push(&one());
        let before = crate::sh::color(0, map.sh_of(1), [0.6, 0.0, 0.8]);
        map.raise_sh_degree(2);
        map.validate().expect("consistent");
        assert_eq!(map.sh_of(1).len(), 9, "degree 2");
        let after = crate::sh::color(2, map.sh_of(1), [0.6, 0.0, 0.8]);
        assert_eq!(
            before.map(f64::to_bits),
            after.map(f64::to_bits),
            "new coefficients are 0"
        );
        map.raise_sh_degree(1);
        assert_eq!(map.sh_degree(), 2, "never lower");
    }

    #[test]
    fn validate_names_what_is_wrong() {
        let mut map = GaussianMap::<f64>::new(0);
        map.push(&one());
        map.means[0][1] = f64::NAN;
        assert!(
            map.validate().expect_err("NaN").contains("Gaussian 0"),
            "names the row"
        );
        map.means[0][1] = 0.0;
        map.label.clear();
        assert!(
            map.validate().expect_err("short").contains("label"),
            "names the array"
        );
    }
}
