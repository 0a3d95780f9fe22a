//! Which Gaussians move: cues, unary terms and a dense conditional random field by mean field.
