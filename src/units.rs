//! Quantities in fixed point, one type a unit, and the gains that turn one into another.
//!
//! 32-bit values with 64-bit products: displacement Q7.24 um (+-128 um, 0.06 pm), voltage Q9.22 V (+-512 V, 0.24 uV), charge Q9.22 uC.
//! Every operation saturates. A [`Gain<A, B>`] turns an `A` into a [`Wide<B>`], the sum of products before rounding; the
//! binary points of gains are chosen such that every `Wide` has 46 fraction bits, whatever it was made from:
//!
//! ```
//! use flexstage::units::{Gain, Um, Volt};
//! let stiffness: Gain<Um, Volt> = Gain::from_f32(7.52); // V/um
//! let drive: Volt = (stiffness * Um::from_f32(2.0)).narrow();
//! assert!((drive.to_f64() - 15.04).abs() < 1e-5);
//! ```
//!
//! Adding volts to micrometres does not compile:
//!
//! ```compile_fail
//! use flexstage::{Um, Volt};
//! let nonsense = Um::from_f32(1.0) + Volt::from_f32(1.0);
//! ```

use core::hash::{Hash, Hasher};
use core::marker::PhantomData;
use core::ops::{Add, AddAssign, Mul, Neg, Sub};

use fixed::types::{I8F24, I10F22};

/// Fraction bits of a [`Wide`].
pub const WIDE_FRACTION: u32 = 46;

/// A 32-bit fixed-point quantity with a unit.
pub trait Quantity: Copy {
    /// Fraction bits.
    const FRACTION: u32;
    /// The value with this bit pattern.
    fn from_bits(bits: i32) -> Self;
    /// The bit pattern: value * 2^FRACTION.
    fn to_bits(self) -> i32;
}

/// `wide` / 2^`SHIFT`, rounded down, saturating. Beyond the range, the last 32 - `SHIFT` bits are any: it saturates to
/// within 2^(32 - SHIFT) of the end.
#[inline(always)]
pub fn narrow<const SHIFT: u32>(wide: i64) -> i32 {
    const { assert!(SHIFT > 0 && SHIFT < 32) };
    // A processor of 64 bits sees in one comparison that there is nothing to clamp, which is the rule.
    #[cfg(target_pointer_width = "64")]
    {
        let shifted = wide >> SHIFT;
        if shifted as i32 as i64 == shifted { shifted as i32 } else { join::<SHIFT>(wide) }
    }
    #[cfg(not(target_pointer_width = "64"))]
    join::<SHIFT>(wide)
}

/// [`narrow`] without a comparison: the upper word is clamped and the two words are joined, three instructions on the
/// Cortex-M4 (`ssat`, `lsr`, `orr`), where an exact end would take a comparison and a branch more, forty times a tick.
#[cfg_attr(not(target_pointer_width = "64"), inline(always))]
#[cfg_attr(target_pointer_width = "64", cold, inline(never))]
fn join<const SHIFT: u32>(wide: i64) -> i32 {
    let upper = clamp_bits::<SHIFT>((wide >> 32) as i32);
    // Joined as 64 bits: a shift of the upper word alone would be drawn into the clamp, which is then no `ssat` any more.
    (((upper as u32 as u64) << 32 | (wide as u32 as u64)) >> SHIFT) as i32
}

/// Saturating sum: one `qadd` on the Cortex-M4, an addition and a branch that is never taken on a processor of 64 bits,
/// which would otherwise compute both ends each time.
#[inline(always)]
pub(crate) const fn plus(a: i32, b: i32) -> i32 {
    #[cfg(target_pointer_width = "64")]
    {
        match a.checked_add(b) {
            Some(sum) => sum,
            None => end_towards(a),
        }
    }
    #[cfg(not(target_pointer_width = "64"))]
    a.saturating_add(b)
}

/// Saturating difference, as [`plus`].
#[inline(always)]
pub(crate) const fn minus(a: i32, b: i32) -> i32 {
    #[cfg(target_pointer_width = "64")]
    {
        match a.checked_sub(b) {
            Some(difference) => difference,
            None => end_towards(a),
        }
    }
    #[cfg(not(target_pointer_width = "64"))]
    a.saturating_sub(b)
}

/// The end of the range on the side of `a`.
#[cfg(target_pointer_width = "64")]
#[cold]
#[inline(never)]
const fn end_towards(a: i32) -> i32 {
    if a < 0 { i32::MIN } else { i32::MAX }
}

/// The nearest signed number of `BITS` bits: one `ssat` on the Cortex-M4.
#[inline(always)]
pub(crate) fn clamp_bits<const BITS: u32>(x: i32) -> i32 {
    let most = (1i32 << (BITS - 1)) - 1;
    x.clamp(-most - 1, most)
}

/// The nearest 32-bit value.
#[inline(always)]
pub const fn saturate(wide: i64) -> i32 {
    let narrow = wide as i32;
    if narrow as i64 == wide {
        narrow
    } else if wide < 0 {
        i32::MIN
    } else {
        i32::MAX
    }
}

macro_rules! quantity {
    ($(#[$doc:meta])* $name:ident, $fixed:ty, $unit:literal) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
        #[repr(transparent)]
        pub struct $name($fixed);

        impl $name {
            /// Nothing.
            pub const ZERO: Self = Self(<$fixed>::ZERO);
            /// The largest value.
            pub const MAX: Self = Self(<$fixed>::MAX);
            /// The smallest value.
            pub const MIN: Self = Self(<$fixed>::MIN);

            /// The value with this bit pattern.
            #[inline(always)]
            pub const fn from_bits(bits: i32) -> Self {
                Self(<$fixed>::from_bits(bits))
            }
            /// The bit pattern.
            #[inline(always)]
            pub const fn to_bits(self) -> i32 {
                self.0.to_bits()
            }
            #[doc = concat!("From a number of ", $unit, ": nearest, saturating; not-a-number gives 0.")]
            pub fn from_f32(value: f32) -> Self {
                if value.is_nan() { Self::ZERO } else { Self(<$fixed>::saturating_from_num(value)) }
            }
            #[doc = concat!("From a number of ", $unit, ": nearest, saturating; not-a-number gives 0.")]
            pub fn from_f64(value: f64) -> Self {
                if value.is_nan() { Self::ZERO } else { Self(<$fixed>::saturating_from_num(value)) }
            }
            #[doc = concat!("As a number of ", $unit, ".")]
            pub fn to_f32(self) -> f32 {
                self.0.to_num()
            }
            #[doc = concat!("As a number of ", $unit, ", exactly.")]
            pub fn to_f64(self) -> f64 {
                self.0.to_num()
            }
            /// Magnitude, saturating.
            #[inline(always)]
            pub const fn abs(self) -> Self {
                Self(self.0.saturating_abs())
            }
            /// The nearest value within `low..=high`. Unlike `Ord::clamp` it cannot panic: `low` wins if they are crossed.
            #[inline(always)]
            pub const fn limit(self, low: Self, high: Self) -> Self {
                let (x, low, high) = (self.to_bits(), low.to_bits(), high.to_bits());
                let x = if x > high { high } else { x };
                Self::from_bits(if x < low { low } else { x })
            }
            /// An integer multiple, saturating.
            #[inline(always)]
            pub const fn times(self, factor: i32) -> Self {
                Self::from_bits(saturate(self.to_bits() as i64 * factor as i64))
            }
        }
        impl Quantity for $name {
            const FRACTION: u32 = <$fixed>::FRAC_NBITS;
            #[inline(always)]
            fn from_bits(bits: i32) -> Self {
                Self::from_bits(bits)
            }
            #[inline(always)]
            fn to_bits(self) -> i32 {
                self.to_bits()
            }
        }
        impl Add for $name {
            type Output = Self;
            #[inline(always)]
            fn add(self, other: Self) -> Self {
                Self(<$fixed>::from_bits(plus(self.0.to_bits(), other.0.to_bits())))
            }
        }
        impl AddAssign for $name {
            #[inline(always)]
            fn add_assign(&mut self, other: Self) {
                *self = *self + other;
            }
        }
        impl Sub for $name {
            type Output = Self;
            #[inline(always)]
            fn sub(self, other: Self) -> Self {
                Self(<$fixed>::from_bits(minus(self.0.to_bits(), other.0.to_bits())))
            }
        }
        impl Neg for $name {
            type Output = Self;
            #[inline(always)]
            fn neg(self) -> Self {
                Self(self.0.saturating_neg())
            }
        }
        impl core::fmt::Display for $name {
            fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
                core::fmt::Display::fmt(&self.0, f)?;
                f.write_str(concat!(" ", $unit))
            }
        }
    };
}

quantity!(
    /// Displacement in micrometres, Q7.24.
    Um, I8F24, "um"
);
quantity!(
    /// Velocity in micrometres per 0.2 ms (two ticks: a central difference as it is), Q7.24.
    UmPer2Ticks, I8F24, "um/(0.2 ms)"
);
quantity!(
    /// Acceleration in micrometres per (0.4 ms)^2 (four ticks: 16 times a second difference), Q7.24.
    UmPer4Ticks2, I8F24, "um/(0.4 ms)^2"
);
quantity!(
    /// Voltage in volts, Q9.22.
    Volt, I10F22, "V"
);
quantity!(
    /// Charge in microcoulombs, Q9.22.
    MicroCoulomb, I10F22, "uC"
);

/// A sum of products on its way to a `B`: 64 bits, 46 of them fraction.
///
/// A product of a gain (below 2^29 by construction) and a quantity stays below 2^60, so that up to seven of them are
/// added exactly; nothing in the core adds more without rounding in between.
#[derive(Debug)]
pub struct Wide<B>(i64, PhantomData<B>);

impl<B> Clone for Wide<B> {
    #[inline(always)]
    fn clone(&self) -> Self {
        *self
    }
}
impl<B> Copy for Wide<B> {}

impl<B: Quantity> Wide<B> {
    /// Nothing.
    pub const ZERO: Self = Self(0, PhantomData);

    /// From 2^-46 parts.
    #[inline(always)]
    pub const fn from_bits(bits: i64) -> Self {
        Self(bits, PhantomData)
    }
    /// 2^-46 parts.
    #[inline(always)]
    pub const fn to_bits(self) -> i64 {
        self.0
    }
    /// Widen a quantity.
    #[inline(always)]
    pub fn of(value: B) -> Self {
        Self((value.to_bits() as i64) << (WIDE_FRACTION - B::FRACTION), PhantomData)
    }
    /// Round down and saturate (to within 2^-14 of the end of the range; see [`narrow`]).
    #[inline(always)]
    pub fn narrow(self) -> B {
        // A constant in a generic function cannot depend on `B`; this is resolved at compile time all the same.
        match B::FRACTION {
            22 => B::from_bits(narrow::<{ WIDE_FRACTION - 22 }>(self.0)),
            _ => B::from_bits(narrow::<{ WIDE_FRACTION - 24 }>(self.0)),
        }
    }
    /// The nearest value within +-`limit`.
    #[inline(always)]
    pub fn limit(self, limit: B) -> Self {
        let limit = Self::of(limit).0;
        let x = if self.0 > limit { limit } else { self.0 };
        Self(if x < -limit { -limit } else { x }, PhantomData)
    }
}
impl<B> Add for Wide<B> {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        Self(self.0.wrapping_add(other.0), PhantomData)
    }
}
impl<B> Sub for Wide<B> {
    type Output = Self;
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        Self(self.0.wrapping_sub(other.0), PhantomData)
    }
}

/// A factor from an `A` to a `B`, in units of `B` per unit of `A`.
///
/// Its binary point makes every product a [`Wide`]: Q9.22 for displacements (+-128), Q7.24 for voltages and charges (+-32).
#[derive(Debug)]
pub struct Gain<A, B>(i32, PhantomData<(A, B)>);

impl<A, B> Clone for Gain<A, B> {
    #[inline(always)]
    fn clone(&self) -> Self {
        *self
    }
}
impl<A, B> Copy for Gain<A, B> {}
impl<A, B> PartialEq for Gain<A, B> {
    fn eq(&self, other: &Self) -> bool {
        self.0 == other.0
    }
}
impl<A, B> Eq for Gain<A, B> {}
impl<A, B> Hash for Gain<A, B> {
    fn hash<H: Hasher>(&self, state: &mut H) {
        self.0.hash(state);
    }
}

impl<A: Quantity, B: Quantity> Gain<A, B> {
    /// No effect.
    pub const ZERO: Self = Self(0, PhantomData);
    const FRACTION: u32 = WIDE_FRACTION - A::FRACTION;
    /// Largest magnitude of the bit pattern; sums of seven products then fit 64 bits.
    const LIMIT: i32 = 1 << 29;
    /// Largest magnitude that a gain between these units can have.
    pub const MAX: f32 = (Self::LIMIT / (1 << Self::FRACTION)) as f32;

    /// Nearest gain, saturating at +-[`Gain::MAX`]; not-a-number gives 0.
    pub fn from_f32(value: f32) -> Self {
        let scaled = value * (1u32 << Self::FRACTION) as f32;
        // `as` saturates, and gives 0 for not-a-number.
        let bits = if scaled < 0.0 { (scaled - 0.5) as i32 } else { (scaled + 0.5) as i32 };
        Self(bits.clamp(-Self::LIMIT, Self::LIMIT), PhantomData)
    }
    /// As a number.
    pub fn to_f64(self) -> f64 {
        self.0 as f64 / (1u32 << Self::FRACTION) as f64
    }
    /// The gain with this bit pattern.
    #[inline(always)]
    pub(crate) const fn from_bits(bits: i32) -> Self {
        Self(bits, PhantomData)
    }
    /// The bit pattern.
    #[inline(always)]
    pub(crate) const fn to_bits(self) -> i32 {
        self.0
    }
    /// Whether it does nothing.
    #[inline(always)]
    pub const fn is_zero(self) -> bool {
        self.0 == 0
    }
}
impl<A, B> Add for Gain<A, B> {
    type Output = Self;
    /// Sums of gains are checked where a configuration is built.
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        Self(self.0.wrapping_add(other.0), PhantomData)
    }
}
impl<A, B> Sub for Gain<A, B> {
    type Output = Self;
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        Self(self.0.wrapping_sub(other.0), PhantomData)
    }
}
impl<A: Quantity, B: Quantity> Mul<A> for Gain<A, B> {
    type Output = Wide<B>;
    #[inline(always)]
    fn mul(self, value: A) -> Wide<B> {
        Wide((self.0 as i64).wrapping_mul(value.to_bits() as i64), PhantomData)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn formats_hold_what_their_docs_promise() {
        assert_eq!(Um::MAX.to_f64().round(), 128.0);
        assert_eq!(Volt::MAX.to_f64().round(), 512.0);
        assert_eq!(Gain::<Um, Volt>::MAX, 128.0);
        assert_eq!(Gain::<Volt, Volt>::MAX, 32.0);
    }

    #[test]
    fn everything_saturates() {
        assert_eq!(Um::MAX + Um::MAX, Um::MAX);
        assert_eq!(Um::MIN - Um::MAX, Um::MIN);
        assert_eq!(-Volt::MIN, Volt::MAX);
        assert_eq!(Volt::MIN.abs(), Volt::MAX);
        let end = 1 << 8;
        let up = (Gain::<Um, Volt>::from_f32(1e9) * Um::MAX).narrow();
        assert!(up.to_bits() > i32::MAX - end, "{up}");
        let down = (Gain::<Um, Volt>::from_f32(-1e9) * Um::MAX).narrow();
        assert!(down.to_bits() < i32::MIN + end, "{down}");
        assert_eq!(Um::from_f32(f32::NAN), Um::ZERO);
        assert_eq!(Gain::<Um, Um>::from_f32(f32::NAN), Gain::ZERO);
    }

    #[test]
    fn seven_full_products_add_without_wrapping() {
        let most = Gain::<Um, Volt>::from_f32(1e9) * Um::MIN;
        let sum = most + most + most + most + most + most + most;
        assert_eq!(sum.to_bits(), -7 * (1i64 << 60));
        assert!(sum.narrow().to_bits() < i32::MIN + (1 << 8));
    }

    #[test]
    fn both_forms_of_narrowing_agree() {
        // Ends, middles and a spread of bit patterns (Weyl's sequence by the golden ratio).
        let spread = (0..100_000_i64).map(|n| n.wrapping_mul(0x9e37_79b9_7f4a_7c15_u64 as i64));
        let ends = [0, -1, i64::MIN, i64::MAX, (1 << 55) - 1, 1 << 55, -(1 << 55), -(1 << 55) - 1];
        for wide in spread.chain(ends) {
            for wide in [wide, wide >> 5, wide >> 8, wide >> 9, wide >> 20] {
                assert_eq!(narrow::<24>(wide), join::<24>(wide), "{wide}");
                assert_eq!(narrow::<12>(wide), join::<12>(wide), "{wide}");
                assert_eq!(narrow::<29>(wide), join::<29>(wide), "{wide}");
            }
        }
    }

    #[test]
    fn sums_saturate_as_the_library_has_it() {
        let values = [i32::MIN, i32::MIN + 1, -77, -1, 0, 1, 77, i32::MAX - 1, i32::MAX];
        for (a, b) in values.iter().flat_map(|&a| values.map(|b| (a, b))) {
            assert_eq!(plus(a, b), a.saturating_add(b), "{a} + {b}");
            assert_eq!(minus(a, b), a.saturating_sub(b), "{a} - {b}");
        }
    }

    #[test]
    fn narrowing_rounds_down_and_never_wraps() {
        for wide in [0, 1, -1, 255, 256, -256, -257, (1 << 55) - 1, -(1 << 55), 123_456_789_012] {
            assert_eq!(i64::from(narrow::<24>(wide)), wide >> 24, "{wide}");
        }
        for wide in [1 << 55, (1 << 55) + 12_345, 1 << 62, i64::MAX] {
            assert!(narrow::<24>(wide) > i32::MAX - 256, "{wide}");
            assert!(narrow::<24>(-wide) < i32::MIN + 256, "{wide}");
        }
        assert!(narrow::<29>(i64::MIN) < i32::MIN + 8);
    }
}
