//! The same function compiled for several widths of instructions, of which a call takes the widest that the machine has.
//!
//! Nothing depends on the width: multiplications are fused with additions only where it is written so, which a machine that
//! cannot do it computes by a slow function, and sums have one order. So every machine computes the same bits, which
//! `dispatch_tests` looks at.

/// Makes `$name`, which is `$body` at the widest instructions of the machine; in tests, at those that the test allows.
macro_rules! dispatched {
    ($name:ident => $body:ident($($argument:ident: $type:ty),* $(,)?) $(-> $out:ty)?) => {
        #[doc = concat!("[`", stringify!($body), "`] at the widest instructions of this machine.")]
        pub(super) fn $name($($argument: $type),*) $(-> $out)? {
            #[multiversion::multiversion(targets(
                "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl+avx2+fma+bmi1+bmi2",
                "x86_64+avx2+fma+bmi1+bmi2"
            ))]
            fn widest($($argument: $type),*) $(-> $out)? {
                $body($($argument),*)
            }
            #[cfg(test)]
            {
                #[multiversion::multiversion(targets("x86_64+avx2+fma+bmi1+bmi2"))]
                fn avx2($($argument: $type),*) $(-> $out)? {
                    $body($($argument),*)
                }
                match $crate::runout::dispatch::ALLOWED.get() {
                    $crate::runout::dispatch::Level::Baseline => return $body($($argument),*),
                    $crate::runout::dispatch::Level::Avx2 => return avx2($($argument),*),
                    $crate::runout::dispatch::Level::Widest => {}
                }
            }
            widest($($argument),*)
        }
    };
}
pub(super) use dispatched;

/// Instructions that a test allows.
#[cfg(test)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Level {
    /// What the target has at least: SSE2 on x86-64, NEON on aarch64.
    Baseline,
    /// AVX2 and FMA, where the machine has them.
    Avx2,
    /// All that the machine has.
    Widest,
}

#[cfg(test)]
thread_local! {
    /// What the dynamics of this thread may use.
    pub(super) static ALLOWED: std::cell::Cell<Level> = const { std::cell::Cell::new(Level::Widest) };
}
