//! Control core of flexstage.
#![no_std]
