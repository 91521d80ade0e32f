//! Faults seeded into the plain backward pass, to test the gradient check itself. Each is a mistake that was made in a
//! public rasteriser or is easily made, and must be caught by the same finite differences that guard the sound code
//! (`check/gradient_check.rs`). The sound pass carries [`Sound`], which has no size and no fault, so that the compiler
//! removes every test for faults.

/// A mistake in the backward pass.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// The contribution from behind a splat does not shrink when its alpha grows.
    OcclusionForgotten,
    /// The part behind is not divided by `1 - alpha`.
    SurvivalFactorMissing,
    /// The gradient flows through an alpha that was clamped at 0.99.
    AlphaCutIgnored,
    /// The mixed moment counts half (OpenSplat 1.1 and 1.2).
    MixedMomentHalved,
    /// The depth is differentiated as if it were not divided by alpha.
    DepthQuotientForgotten,
    /// `+Q G Q` for the inverse of the covariance, instead of `-Q G Q`.
    CovarianceSignFlipped,
    /// A factor of 2 is missing between covariance and columns.
    ColumnFactorMissing,
    /// The camera's rotation instead of its transpose.
    CameraTransposed,
    /// The Jacobian of the projection is taken as constant.
    JacobianHeldFixed,
    /// The clamp of the pinhole's Jacobian is ignored.
    JacobianClampIgnored,
    /// The view direction of the SH is taken as constant (gsplat before 1.0, OpenSplat).
    ViewDirectionHeldFixed,
    /// The gradient flows through a colour that was clamped at 0.
    ColorCutIgnored,
    /// The quaternion is differentiated as if it were not normalised.
    QuaternionNotNormalized,
    /// The rotation of an ellipsoid is taken transposed (3dgs-warp-scratch).
    EllipsoidTransposed,
    /// The gradient of the opacity is that of its logarithm.
    OpacityFactorMissing,
    /// The eye stays when the camera is pushed.
    EyeHeldFixed,
    /// The factor of the opacity of `Filter::Compensate` is taken as constant.
    CompensationHeldFixed,
    /// The plane of an exact disc does not tilt.
    PlaneTiltIgnored,
    /// The screen filter of an exact disc stays when the centre moves.
    FilterCenterHeldFixed,
}

impl Fault {
    /// All of them.
    pub const ALL: [Fault; 19] = [
        Fault::OcclusionForgotten,
        Fault::SurvivalFactorMissing,
        Fault::AlphaCutIgnored,
        Fault::MixedMomentHalved,
        Fault::DepthQuotientForgotten,
        Fault::CovarianceSignFlipped,
        Fault::ColumnFactorMissing,
        Fault::CameraTransposed,
        Fault::JacobianHeldFixed,
        Fault::JacobianClampIgnored,
        Fault::ViewDirectionHeldFixed,
        Fault::ColorCutIgnored,
        Fault::QuaternionNotNormalized,
        Fault::EllipsoidTransposed,
        Fault::OpacityFactorMissing,
        Fault::EyeHeldFixed,
        Fault::CompensationHeldFixed,
        Fault::PlaneTiltIgnored,
        Fault::FilterCenterHeldFixed,
    ];
}

/// Which faults a backward pass has.
pub trait Faults: Copy + Send + Sync {
    /// Whether it has this one.
    fn has(self, fault: Fault) -> bool;
    /// Whether it has none, and the vectorised kernels may do its work.
    fn is_sound(self) -> bool;
}

/// None.
#[derive(Clone, Copy)]
pub struct Sound;

impl Faults for Sound {
    #[inline(always)]
    fn has(self, _: Fault) -> bool {
        false
    }

    #[inline(always)]
    fn is_sound(self) -> bool {
        true
    }
}

impl Faults for Fault {
    #[inline(always)]
    fn has(self, fault: Fault) -> bool {
        self == fault
    }

    #[inline(always)]
    fn is_sound(self) -> bool {
        false
    }
}
