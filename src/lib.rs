//! Control core of flexstage.
#![no_std]
pub mod link;
