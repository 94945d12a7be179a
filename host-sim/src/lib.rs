//! Plant model of a piezo-driven flexure stage, running the same control core as the board.
