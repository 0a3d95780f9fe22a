//! FAST, ORB, Hamming matching, pyramidal Lucas-Kanade and two-view geometry
