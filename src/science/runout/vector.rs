//! Four numbers of a node in a register: products and sums of the transfers, which compilers leave scalar.
//!
//! In single precision `wide` takes the 128-bit instructions that every x86-64 and every aarch64 has, and plain arrays
//! elsewhere; what is compiled for wider registers encodes them anew. In double precision it would cut the four in two where
//! the whole program is not compiled for more, so there it is arrays, which compilers do put together. What is fused is
//! rounded once everywhere, so all give the same bits.

use wide::f32x4;

/// Four numbers: (x, z) and (x, z) of a velocity, or (x, z) of a momentum and a mass.
pub(super) trait Vector<T>: Copy {
    fn load(from: &[T; 4]) -> Self;
    fn store(self, to: &mut [T; 4]);
    fn splat(x: T) -> Self;
    fn add(self, other: Self) -> Self;
    fn sub(self, other: Self) -> Self;
    fn mul(self, other: Self) -> Self;
    fn div(self, other: Self) -> Self;
    /// `self * by + plus`, rounded once.
    fn mul_add(self, by: Self, plus: Self) -> Self;
    /// The smaller of each; the second where one is none.
    fn min(self, other: Self) -> Self;
    /// The larger of each; the second where one is none.
    fn max(self, other: Self) -> Self;
    /// The last two with the other sign.
    fn flip_upper(self) -> Self;
    /// Zero for the last two.
    fn lower(self) -> Self;
    /// The first of each, the second of each, and so on.
    fn transpose(rows: [Self; 4]) -> [Self; 4];
}

impl Vector<f32> for f32x4 {
    #[inline(always)]
    fn load(from: &[f32; 4]) -> Self {
        Self::new(*from)
    }

    #[inline(always)]
    fn store(self, to: &mut [f32; 4]) {
        *to = self.to_array();
    }

    #[inline(always)]
    fn splat(x: f32) -> Self {
        Self::new([x; 4])
    }

    #[inline(always)]
    fn add(self, other: Self) -> Self {
        self + other
    }

    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        self - other
    }

    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        self * other
    }

    #[inline(always)]
    fn div(self, other: Self) -> Self {
        self / other
    }

    #[inline(always)]
    fn mul_add(self, by: Self, plus: Self) -> Self {
        // that of `wide` is fused only where the whole program is compiled for it; compilers put this together
        let (a, b, c) = (self.to_array(), by.to_array(), plus.to_array());
        Self::new([
            a[0].mul_add(b[0], c[0]),
            a[1].mul_add(b[1], c[1]),
            a[2].mul_add(b[2], c[2]),
            a[3].mul_add(b[3], c[3]),
        ])
    }

    #[inline(always)]
    fn min(self, other: Self) -> Self {
        self.fast_min(other)
    }

    #[inline(always)]
    fn max(self, other: Self) -> Self {
        self.fast_max(other)
    }

    #[inline(always)]
    fn flip_upper(self) -> Self {
        self ^ Self::new([0.0, 0.0, -0.0, -0.0])
    }

    #[inline(always)]
    fn lower(self) -> Self {
        let all = f32::from_bits(!0);
        self & Self::new([all, all, 0.0, 0.0])
    }

    #[inline(always)]
    fn transpose(rows: [Self; 4]) -> [Self; 4] {
        Self::transpose(rows)
    }
}

/// Four numbers of an array.
#[derive(Clone, Copy, Debug)]
#[repr(align(32))]
pub(super) struct Four([f64; 4]);

impl Four {
    #[inline(always)]
    fn each(self, other: Self, f: impl Fn(f64, f64) -> f64) -> Self {
        let (a, b) = (self.0, other.0);
        Self([f(a[0], b[0]), f(a[1], b[1]), f(a[2], b[2]), f(a[3], b[3])])
    }
}

impl Vector<f64> for Four {
    #[inline(always)]
    fn load(from: &[f64; 4]) -> Self {
        Self(*from)
    }

    #[inline(always)]
    fn store(self, to: &mut [f64; 4]) {
        *to = self.0;
    }

    #[inline(always)]
    fn splat(x: f64) -> Self {
        Self([x; 4])
    }

    #[inline(always)]
    fn add(self, other: Self) -> Self {
        self.each(other, |a, b| a + b)
    }

    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        self.each(other, |a, b| a - b)
    }

    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        self.each(other, |a, b| a * b)
    }

    #[inline(always)]
    fn div(self, other: Self) -> Self {
        self.each(other, |a, b| a / b)
    }

    #[inline(always)]
    fn mul_add(self, by: Self, plus: Self) -> Self {
        let (a, b, c) = (self.0, by.0, plus.0);
        Self([a[0].mul_add(b[0], c[0]), a[1].mul_add(b[1], c[1]), a[2].mul_add(b[2], c[2]), a[3].mul_add(b[3], c[3])])
    }

    #[inline(always)]
    fn min(self, other: Self) -> Self {
        self.each(other, |a, b| if a < b { a } else { b })
    }

    #[inline(always)]
    fn max(self, other: Self) -> Self {
        self.each(other, |a, b| if a > b { a } else { b })
    }

    #[inline(always)]
    fn flip_upper(self) -> Self {
        let [a, b, c, d] = self.0;
        Self([a, b, -c, -d])
    }

    #[inline(always)]
    fn lower(self) -> Self {
        let [a, b, ..] = self.0;
        Self([a, b, 0.0, 0.0])
    }

    #[inline(always)]
    fn transpose(rows: [Self; 4]) -> [Self; 4] {
        let [a, b, c, d] = [rows[0].0, rows[1].0, rows[2].0, rows[3].0];
        let column = |i: usize| Self([a[i], b[i], c[i], d[i]]);
        [column(0), column(1), column(2), column(3)]
    }
}

#[cfg(test)]
mod tests {
    use std::array;

    use proptest::prelude::*;

    use super::*;
    use crate::runout::lanes::{self, Real};

    /// Four numbers one by one.
    #[derive(Clone, Copy, Debug)]
    struct Plain<T>([T; 4]);

    impl<T: Real> Plain<T> {
        fn each(self, other: Self, f: impl Fn(T, T) -> T) -> Self {
            let (a, b) = (self.0, other.0);
            Self([f(a[0], b[0]), f(a[1], b[1]), f(a[2], b[2]), f(a[3], b[3])])
        }
    }

    impl<T: Real> Vector<T> for Plain<T> {
        fn load(from: &[T; 4]) -> Self {
            Self(*from)
        }

        fn store(self, to: &mut [T; 4]) {
            *to = self.0;
        }

        fn splat(x: T) -> Self {
            Self([x; 4])
        }

        fn add(self, other: Self) -> Self {
            self.each(other, |a, b| a + b)
        }

        fn sub(self, other: Self) -> Self {
            self.each(other, |a, b| a - b)
        }

        fn mul(self, other: Self) -> Self {
            self.each(other, |a, b| a * b)
        }

        fn mul_add(self, by: Self, plus: Self) -> Self {
            let fused = |i: usize| self.0[i].mul_add(by.0[i], plus.0[i]);
            Self([fused(0), fused(1), fused(2), fused(3)])
        }

        fn min(self, other: Self) -> Self {
            self.each(other, lanes::min)
        }

        fn max(self, other: Self) -> Self {
            self.each(other, lanes::max)
        }

        fn div(self, other: Self) -> Self {
            self.each(other, |a, b| a / b)
        }

        fn flip_upper(self) -> Self {
            let [a, b, c, d] = self.0;
            Self([a, b, -c, -d])
        }

        fn lower(self) -> Self {
            let [a, b, ..] = self.0;
            Self([a, b, T::of(0.0), T::of(0.0)])
        }

        fn transpose(rows: [Self; 4]) -> [Self; 4] {
            array::from_fn(|column| Self(array::from_fn(|row| rows[row].0[column])))
        }
    }

    fn results<T: Real, V: Vector<T>>(a: &[T; 4], b: &[T; 4]) -> Vec<[u64; 4]> {
        let (x, y) = (V::load(a), V::load(b));
        let pairs = [x.add(y), x.sub(y), x.mul(y), x.div(y), x.min(y), x.max(y), x.mul_add(y, x)];
        let single = [x.flip_upper(), x.lower(), V::splat(a[1])];
        let turned = V::transpose([x, y, x.add(y), y.flip_upper()]);
        let bits = |v: &V| {
            let mut out = [T::of(0.0); 4];
            v.store(&mut out);
            out.map(|x| x.f64().to_bits())
        };
        pairs.iter().chain(&single).chain(&turned).map(bits).collect()
    }

    proptest! {
        #[test]
        fn every_machine_computes_what_arrays_do(
            a in prop::array::uniform4(-1e20..1e20),
            b in prop::array::uniform4(-1e-3..1e20),
        ) {
            prop_assert_eq!(results::<f64, Four>(&a, &b), results::<f64, Plain<f64>>(&a, &b));
            let (a, b) = (a.map(|x| x as f32 / 1e10), b.map(|x| x as f32 / 1e10));
            prop_assert_eq!(results::<f32, f32x4>(&a, &b), results::<f32, Plain<f32>>(&a, &b));
        }
    }
}
