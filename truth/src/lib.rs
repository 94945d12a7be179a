//! Recordings with withheld effects, made by an integrator and effect models of their own.
