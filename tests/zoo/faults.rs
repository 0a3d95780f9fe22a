//! A table of faulty ports: every fault with the stage it belongs to, and the report it was taken from.

/// A port with one mistake.
pub(crate) struct FaultyPort<F> {
    pub(crate) fault: F,
    /// Where it belongs.
    pub(crate) stage: &'static str,
    /// The issue that reported it, or `port`: a mistake made by hand, as in examples/adapter_numpy/mutants.py.
    pub(crate) report: &'static str,
}

/// `Fault`, one mistake at a time, and `FAULTY_PORTS`.
macro_rules! faults {
    ($($stage:literal { $($fault:ident $report:literal)* })*) => {
        #[derive(Debug, Clone, Copy, PartialEq, Eq)]
        pub(crate) enum Fault {
            $($($fault,)*)*
        }

        pub(crate) const FAULTY_PORTS: &[super::faults::FaultyPort<Fault>] = &[
            $($(super::faults::FaultyPort { fault: Fault::$fault, stage: $stage, report: $report },)*)*
        ];
    };
}
pub(crate) use faults;
