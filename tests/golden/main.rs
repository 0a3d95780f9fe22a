//! The golden cases as a whole: that the trace of several frames is what this program still does, and that every
//! stage and every equation has a case.

mod coverage;
mod trace;
