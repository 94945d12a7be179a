//! Why a simulation and a rig disagree: locate, name, fit and accept.
