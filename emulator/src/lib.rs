//! Runs the flashed firmware image: Cortex-M4, its peripherals and the plant.
