//! Which Embree the program runs on, and which one it was built against.

use super::trace::embree;

/// An Embree version as the library counts it: 40303 is 4.3.3.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct EmbreeVersion(pub u32);

impl std::fmt::Display for EmbreeVersion {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}.{}.{}", self.0 / 10_000, self.0 / 100 % 100, self.0 % 100)
    }
}

/// The headers that the bindings were made from.
pub const EMBREE_HEADER: EmbreeVersion = EmbreeVersion(embree::RTC_VERSION);

/// The library that the process has loaded; `None` when it cannot make a device.
pub fn embree_runtime() -> Option<EmbreeVersion> {
    // SAFETY: a null configuration is documented as "defaults"; the device is checked for null before use and
    // released exactly once, here.
    unsafe {
        let device = embree::rtcNewDevice(std::ptr::null());
        if device.is_null() {
            return None;
        }
        let version = embree::rtcGetDeviceProperty(device, embree::RTCDeviceProperty::RTC_DEVICE_PROPERTY_VERSION);
        embree::rtcReleaseDevice(device);
        u32::try_from(version).ok().map(EmbreeVersion)
    }
}

/// One sentence when `runtime` cannot serve a program built against `header`: it must be of the same major version
/// and not older, since an older library does not know every field of the newer structures.
pub fn embree_complaint(runtime: Option<EmbreeVersion>, header: EmbreeVersion) -> Option<String> {
    let Some(runtime) = runtime else { return Some("Embree cannot make a device".into()) };
    (runtime.0 / 10_000 != header.0 / 10_000 || runtime.0 / 100 < header.0 / 100)
        .then(|| format!("Embree {runtime} runs, but the program was built for {header}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_older_or_other_embree_is_refused() {
        let header = EmbreeVersion(40_303);
        assert_eq!(embree_complaint(embree_runtime(), EMBREE_HEADER), None);
        assert_eq!(embree_complaint(Some(EmbreeVersion(40_400)), header), None);
        assert_eq!(embree_complaint(Some(EmbreeVersion(40_300)), header), None);
        let old = embree_complaint(Some(EmbreeVersion(40_200)), header).unwrap();
        assert!(old.contains("4.2.0") && old.contains("4.3.3"), "{old}");
        assert!(embree_complaint(Some(EmbreeVersion(50_000)), header).is_some());
        assert!(embree_complaint(None, header).is_some());
    }
}
