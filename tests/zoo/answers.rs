//! What a port is given, and its answers as the judge takes them.

use garad_conformance::Outputs;
use garad_golden::answers::Answers;
use garad_golden::{Case, Inputs, Tensor};

/// The inputs of a case. One that lacks something is a mistake of this test.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Given<'a>(pub(crate) &'a Inputs);

impl<'a> Given<'a> {
    pub(crate) fn get(self, name: &str) -> Option<&'a Tensor> {
        self.0.get(name)
    }

    pub(crate) fn tensor(self, name: &str) -> &'a Tensor {
        self.0.tensor(name).expect("an input of the stage")
    }

    pub(crate) fn reals(self, name: &str) -> Vec<f64> {
        self.tensor(name).f64()
    }

    pub(crate) fn rows<const N: usize>(self, name: &str) -> Vec<[f64; N]> {
        self.0.rows(name).expect("an input of the stage")
    }

    pub(crate) fn number(self, name: &str) -> f64 {
        self.0.number(name).expect("a parameter of the stage")
    }

    pub(crate) fn count(self, name: &str) -> usize {
        self.0.count(name).expect("a parameter of the stage")
    }

    pub(crate) fn switch(self, name: &str) -> bool {
        self.0.switch(name).expect("a parameter of the stage")
    }

    pub(crate) fn word(self, name: &str) -> &'a str {
        self.0.word(name).expect("a parameter of the stage")
    }
}

/// Flat lists under the expected shapes, where they have as many numbers.
pub(crate) fn shaped(case: &Case, out: &Outputs) -> Answers {
    let one = |(name, tensor): (&String, &Tensor)| {
        let expected = case
            .outputs()
            .get(name)
            .filter(|_| tensor.shape().len() == 1);
        let shaped = expected.and_then(|e| tensor.clone().reshape(e.shape()));
        (name.clone(), Ok(shaped.unwrap_or_else(|| tensor.clone())))
    };
    out.tensors().iter().map(one).collect()
}
