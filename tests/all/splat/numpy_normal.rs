//! `numpy.random.Generator(PCG64(77)).standard_normal`: the weights of the loss of `../shared/reference/splat`.
//! PCG XSL-RR 128/64 (O'Neill, 2014) and numpy's 256-layer ziggurat (Marsaglia and Tsang, 2000).

const LAYERS: usize = 256;
const TAIL: f64 = 3.654_152_885_361_009;
const AREA: f64 = 0.004_928_673_233_974_655;

/// The generator after `PCG64(77)`, tables included.
pub struct Numpy {
    state: u128,
    increment: u128,
    widths: [f64; LAYERS],
    heights: [f64; LAYERS],
    limits: [u64; LAYERS],
}

impl Numpy {
    /// `Generator(PCG64(77))`.
    pub fn seeded_77() -> Self {
        let unit = (1u64 << 52) as f64;
        let density = |x: f64| (-0.5 * x * x).exp();
        let mut edges = [0.0; LAYERS + 1];
        edges[LAYERS] = AREA / density(TAIL);
        edges[LAYERS - 1] = TAIL;
        for i in (1..LAYERS - 1).rev() {
            let outer: f64 = edges[i + 1];
            edges[i] = (-2.0 * (AREA / outer + density(outer)).ln()).sqrt();
        }
        // Layer 0 is the tail's; layer i ends at edge i.
        let mut numpy = Numpy {
            state: 289533129354323354318955456298181112347,
            increment: 336983293413220778415499640756163231851,
            widths: [0.0; LAYERS],
            heights: [0.0; LAYERS],
            limits: [0; LAYERS],
        };
        for i in 0..LAYERS {
            let (outer, inner) = if i == 0 { (edges[LAYERS], TAIL) } else { (edges[i], edges[i - 1]) };
            numpy.widths[i] = outer / unit;
            numpy.limits[i] = (inner / outer * unit) as u64;
            numpy.heights[i] = if i == 0 { 1.0 } else { density(edges[i]) };
        }
        numpy
    }

    fn word(&mut self) -> u64 {
        const MULTIPLIER: u128 = 0x2360_ed05_1fc6_5da4_4385_df64_9fcc_f645;
        self.state = self.state.wrapping_mul(MULTIPLIER).wrapping_add(self.increment);
        (((self.state >> 64) ^ self.state) as u64).rotate_right((self.state >> 122) as u32)
    }

    fn unit(&mut self) -> f64 {
        (self.word() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// The next value.
    pub fn normal(&mut self) -> f64 {
        loop {
            let word = self.word();
            let (layer, rest) = ((word & 0xff) as usize, word >> 8);
            let (negative, bits) = (rest & 1 == 1, (rest >> 1) & 0x000f_ffff_ffff_ffff);
            let size = bits as f64 * self.widths[layer];
            let x = if negative { -size } else { size };
            if bits < self.limits[layer] {
                return x;
            }
            if layer == 0 {
                loop {
                    let beyond = -(-self.unit()).ln_1p() / TAIL;
                    let height = -(-self.unit()).ln_1p();
                    if height + height > beyond * beyond {
                        return if (bits >> 8) & 1 == 1 { -(TAIL + beyond) } else { TAIL + beyond };
                    }
                }
            }
            let (below, above) = (self.heights[layer], self.heights[layer - 1]);
            if (above - below) * self.unit() + below < (-0.5 * x * x).exp() {
                return x;
            }
        }
    }
}

#[test]
fn the_weights_are_numpys() {
    // numpy 2: `Generator(PCG64(77)).standard_normal(256 * 256 * 3)`.
    let mut numpy = Numpy::seeded_77();
    let values: Vec<f64> = (0..256 * 256 * 3).map(|_| numpy.normal()).collect();
    for (value, truth) in values.iter().zip([0.42776996, -0.57083756, 2.65446069, -1.60854495, 0.66171566]) {
        assert!((value - truth).abs() < 1e-8, "{value} is not {truth}");
    }
    assert_eq!(values.iter().filter(|v| v.abs() > TAIL).count(), 46);
    assert!((values.iter().sum::<f64>() - 324.38054344305635).abs() < 1e-6);
    for (value, truth) in values.iter().rev().zip([1.17070957, -0.43614006, 0.28543485]) {
        assert!((value - truth).abs() < 1e-8, "{value} is not {truth}");
    }
}
