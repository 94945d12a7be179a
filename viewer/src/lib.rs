//! The telemetry viewer window.
