//! The window driven as a person drives it, by what a screen reader sees: no GPU, a virtual board behind it. One binary, so that the window
//! is linked once.

mod common;
mod connection;
mod files;
mod panels;
mod settings;
mod traces;
