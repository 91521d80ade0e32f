//! OpenCV: separable Gaussian filtering for SSIM, contour analysis. `Mat` never leaves this file.

/// Version of the OpenCV library that is linked.
pub fn version() -> String {
    opencv::core::get_version_string().unwrap_or_else(|_| "unknown".into())
}

#[cfg(test)]
mod tests {
    #[test]
    fn opencv_answers() {
        assert!(super::version().starts_with('4'), "{}", super::version());
    }
}
