//! AVX2: one register for eight f32 or four f64. A vector carries the proof that the processor has it.

use std::arch::x86_64::{__m256, __m256d, _CMP_GE_OQ, _CMP_GT_OQ, _CMP_LE_OQ};
use std::ops::{Add, AddAssign, BitAnd, BitOr, BitXor, Div, Mul, Sub};

use pulp::x86::V3;
use wide::bytemuck::cast;
use wide::f32x4;

use super::{F32x8, F64x4, Kernel, Lanes};

/// A kernel to be compiled with AVX2.
pub(super) struct OnAvx2<K> {
    pub(super) simd: V3,
    pub(super) kernel: K,
}

impl<K: Kernel> pulp::NullaryFnOnce for OnAvx2<K> {
    type Output = K::Output;

    #[inline(always)]
    fn call(self) -> K::Output {
        self.kernel.run(Avx2(self.simd))
    }
}

#[derive(Debug, Clone, Copy)]
pub(super) struct Avx2(V3);

#[derive(Debug, Clone, Copy)]
pub(super) struct Single(__m256, V3);

#[derive(Debug, Clone, Copy)]
pub(super) struct Double(__m256d, V3);

impl Lanes for Avx2 {
    type F32x8 = Single;
    type F64x4 = Double;

    #[inline(always)]
    fn load(self, lanes: [f32; 8]) -> Single {
        Single(cast(lanes), self.0)
    }

    #[inline(always)]
    fn load_f64(self, lanes: [f64; 4]) -> Double {
        Double(cast(lanes), self.0)
    }
}

/// `a OP b` by one instruction.
macro_rules! operator {
    ($vector:ident: $($operator:ident $method:ident $instruction:ident,)+) => {$(
        impl $operator for $vector {
            type Output = Self;

            #[inline(always)]
            fn $method(self, other: Self) -> Self {
                Self(self.1.avx.$instruction(self.0, other.0), self.1)
            }
        }
    )+};
}

operator! { Single:
    Add add _mm256_add_ps,
    Sub sub _mm256_sub_ps,
    Mul mul _mm256_mul_ps,
    Div div _mm256_div_ps,
    BitAnd bitand _mm256_and_ps,
    BitOr bitor _mm256_or_ps,
    BitXor bitxor _mm256_xor_ps,
}

operator! { Double:
    Add add _mm256_add_pd,
    Sub sub _mm256_sub_pd,
    Mul mul _mm256_mul_pd,
    BitAnd bitand _mm256_and_pd,
}

impl AddAssign for Single {
    #[inline(always)]
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
    }
}

impl AddAssign for Double {
    #[inline(always)]
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
    }
}

impl F32x8 for Single {
    #[inline(always)]
    fn to_array(self) -> [f32; 8] {
        cast(self.0)
    }

    #[inline(always)]
    fn halves(self) -> [f32x4; 2] {
        cast(self.0)
    }

    // The instruction returns its second operand where either is NaN.
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        Self(self.1.avx._mm256_min_ps(self.0, other.0), self.1)
    }

    #[inline(always)]
    fn max(self, other: Self) -> Self {
        Self(self.1.avx._mm256_max_ps(self.0, other.0), self.1)
    }

    #[inline(always)]
    fn ge(self, other: Self) -> Self {
        Self(
            self.1.avx._mm256_cmp_ps::<_CMP_GE_OQ>(self.0, other.0),
            self.1,
        )
    }

    #[inline(always)]
    fn gt(self, other: Self) -> Self {
        Self(
            self.1.avx._mm256_cmp_ps::<_CMP_GT_OQ>(self.0, other.0),
            self.1,
        )
    }

    #[inline(always)]
    fn le(self, other: Self) -> Self {
        Self(
            self.1.avx._mm256_cmp_ps::<_CMP_LE_OQ>(self.0, other.0),
            self.1,
        )
    }

    #[inline(always)]
    fn abs(self) -> Self {
        let sign = self.1.avx._mm256_set1_ps(-0.0);
        Self(self.1.avx._mm256_andnot_ps(sign, self.0), self.1)
    }

    #[inline(always)]
    fn sqrt(self) -> Self {
        Self(self.1.avx._mm256_sqrt_ps(self.0), self.1)
    }

    #[inline(always)]
    fn select(self, yes: Self, no: Self) -> Self {
        Self(self.1.avx._mm256_blendv_ps(no.0, yes.0, self.0), self.1)
    }

    #[inline(always)]
    fn signs(self) -> u32 {
        self.1.avx._mm256_movemask_ps(self.0).cast_unsigned()
    }

    #[inline(always)]
    fn times_two_to(self, n: Self) -> Self {
        let exponent = self.1.avx2._mm256_slli_epi32::<23>(cast(n.0));
        Self(
            cast(self.1.avx2._mm256_add_epi32(cast(self.0), exponent)),
            self.1,
        )
    }
}

impl F64x4 for Double {
    #[inline(always)]
    fn to_array(self) -> [f64; 4] {
        cast(self.0)
    }

    #[inline(always)]
    fn max(self, other: Self) -> Self {
        Self(self.1.avx._mm256_max_pd(self.0, other.0), self.1)
    }

    #[inline(always)]
    fn ge(self, other: Self) -> Self {
        Self(
            self.1.avx._mm256_cmp_pd::<_CMP_GE_OQ>(self.0, other.0),
            self.1,
        )
    }

    #[inline(always)]
    fn sqrt(self) -> Self {
        Self(self.1.avx._mm256_sqrt_pd(self.0), self.1)
    }

    #[inline(always)]
    fn times_two_to(self, n: Self) -> Self {
        let exponent = self.1.avx2._mm256_slli_epi64::<52>(cast(n.0));
        Self(
            cast(self.1.avx2._mm256_add_epi64(cast(self.0), exponent)),
            self.1,
        )
    }
}
