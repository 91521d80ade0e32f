//! Real spherical harmonics of degree 0 to 3 with the constants and signs of Inria's 3DGS.

use super::real::Real;

/// The constant basis function.
pub const C0: f64 = 0.28209479177387814;
const C1: f64 = 0.4886025119029199;
const C2: [f64; 5] =
    [1.0925484305920792, -1.0925484305920792, 0.31539156525252005, -1.0925484305920792, 0.5462742152960396];
const C3: [f64; 7] = [
    -0.5900435899266435,
    2.890611442640554,
    -0.4570457994644658,
    0.3731763325901154,
    -0.4570457994644658,
    1.445305721320277,
    -0.5900435899266435,
];

/// The `(degree + 1)^2` basis functions at the unit vector `[x, y, z]`; the rest of the array stays 0.
#[inline(always)]
pub fn basis<T: Real>([x, y, z]: [T; 3], degree: u8) -> [T; 16] {
    let mut out = [T::zero(); 16];
    out[0] = T::of(C0);
    if degree >= 1 {
        out[1] = -T::of(C1) * y;
        out[2] = T::of(C1) * z;
        out[3] = -T::of(C1) * x;
    }
    if degree >= 2 {
        let two = T::of(2.0);
        out[4] = T::of(C2[0]) * x * y;
        out[5] = T::of(C2[1]) * y * z;
        out[6] = T::of(C2[2]) * (two * z * z - x * x - y * y);
        out[7] = T::of(C2[3]) * x * z;
        out[8] = T::of(C2[4]) * (x * x - y * y);
    }
    if degree >= 3 {
        let (two, three, four) = (T::of(2.0), T::of(3.0), T::of(4.0));
        let (xx, yy, zz) = (x * x, y * y, z * z);
        out[9] = T::of(C3[0]) * y * (three * xx - yy);
        out[10] = T::of(C3[1]) * x * y * z;
        out[11] = T::of(C3[2]) * y * (four * zz - xx - yy);
        out[12] = T::of(C3[3]) * z * (two * zz - three * xx - three * yy);
        out[13] = T::of(C3[4]) * x * (four * zz - xx - yy);
        out[14] = T::of(C3[5]) * z * (xx - yy);
        out[15] = T::of(C3[6]) * x * (xx - three * yy);
    }
    out
}

/// Gradient of `sum_k weights[k] * basis[k]` with respect to the vector `[x, y, z]` (as if it were free).
#[inline(always)]
pub fn basis_pullback<T: Real>([x, y, z]: [T; 3], degree: u8, w: &[T; 16]) -> [T; 3] {
    let mut g = [T::zero(); 3];
    if degree >= 1 {
        g = [-T::of(C1) * w[3], -T::of(C1) * w[1], T::of(C1) * w[2]];
    }
    if degree >= 2 {
        let two = T::of(2.0);
        let c: [T; 5] = C2.map(T::of);
        g[0] += c[0] * y * w[4] - two * c[2] * x * w[6] + c[3] * z * w[7] + two * c[4] * x * w[8];
        g[1] += c[0] * x * w[4] + c[1] * z * w[5] - two * c[2] * y * w[6] - two * c[4] * y * w[8];
        g[2] += c[1] * y * w[5] + T::of(4.0) * c[2] * z * w[6] + c[3] * x * w[7];
    }
    if degree >= 3 {
        let (two, three, six, eight) = (T::of(2.0), T::of(3.0), T::of(6.0), T::of(8.0));
        let c: [T; 7] = C3.map(T::of);
        let (xx, yy, zz) = (x * x, y * y, z * z);
        let four_zz = T::of(4.0) * zz;
        g[0] +=
            c[0] * six * x * y * w[9] + c[1] * y * z * w[10] - c[2] * two * x * y * w[11] - c[3] * six * x * z * w[12]
                + c[4] * (four_zz - three * xx - yy) * w[13]
                + c[5] * two * x * z * w[14]
                + c[6] * three * (xx - yy) * w[15];
        g[1] += c[0] * three * (xx - yy) * w[9] + c[1] * x * z * w[10] + c[2] * (four_zz - xx - three * yy) * w[11]
            - c[3] * six * y * z * w[12]
            - c[4] * two * x * y * w[13]
            - c[5] * two * y * z * w[14]
            - c[6] * six * x * y * w[15];
        g[2] += c[1] * x * y * w[10]
            + c[2] * eight * y * z * w[11]
            + c[3] * (six * zz - three * xx - three * yy) * w[12]
            + c[4] * eight * x * z * w[13]
            + c[5] * (xx - yy) * w[14];
    }
    g
}

/// `0.5 + sum_k basis[k] * coefficients[k]` per channel.
#[inline(always)]
pub fn color<T: Real>(basis: &[T; 16], coefficients: &[T]) -> [T; 3] {
    let mut color = [T::of(0.5); 3];
    for (weight, rgb) in basis.iter().zip(coefficients.as_chunks::<3>().0) {
        for k in 0..3 {
            color[k] += *weight * rgb[k];
        }
    }
    color
}
