//! Host side of the board link: transports, device sessions, recorder, probes and measurements.
