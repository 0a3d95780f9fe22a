//! Trajectory alignment, ATE, RPE, image metrics, metrics.json and report.html
