//! Both pyramids of the system: halving for training and flow, 1.2 for ORB.
