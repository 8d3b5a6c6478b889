use rand::SeedableRng;

/// The generator used everywhere: small, fast, and the same on every platform.
pub type Rng = rand_xoshiro::Xoshiro256PlusPlus;

/// A generator for task `stream` of a run with `seed`. Each parallel task takes its own stream,
/// so that results do not depend on which thread ran it.
pub fn rng(seed: u64, stream: u64) -> Rng {
    // SplitMix64's odd constant keeps neighbouring streams far apart in seed space.
    Rng::seed_from_u64(seed ^ stream.wrapping_mul(0x9E37_79B9_7F4A_7C15))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::Rng as _;

    #[test]
    fn streams_differ_and_repeat() {
        let draw = |seed, stream| rng(seed, stream).next_u64();
        assert_eq!(draw(1, 2), draw(1, 2));
        assert_ne!(draw(1, 2), draw(1, 3));
        assert_ne!(draw(1, 2), draw(2, 2));
    }
}
