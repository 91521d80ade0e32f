//! Arrays of numbers inside JSON: little-endian bytes in base64 (RFC 4648, with padding), which a page turns into a
//! typed array without parsing a digit.

use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// Numbers that stand in JSON as base64 of their little-endian bytes.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Packed<T>(pub Vec<T>);

/// A number of fixed width.
pub trait PackedNumber: Copy {
    /// Bytes of one.
    const WIDTH: usize;

    /// Appends its bytes, least first.
    fn put(self, out: &mut Vec<u8>);

    /// The number of `WIDTH` bytes, least first.
    fn of(bytes: &[u8]) -> Self;
}

impl PackedNumber for u8 {
    const WIDTH: usize = 1;

    fn put(self, out: &mut Vec<u8>) {
        out.push(self);
    }

    fn of(bytes: &[u8]) -> Self {
        bytes[0]
    }
}

impl PackedNumber for u16 {
    const WIDTH: usize = 2;

    fn put(self, out: &mut Vec<u8>) {
        out.extend(self.to_le_bytes());
    }

    fn of(bytes: &[u8]) -> Self {
        u16::from_le_bytes([bytes[0], bytes[1]])
    }
}

impl PackedNumber for f32 {
    const WIDTH: usize = 4;

    fn put(self, out: &mut Vec<u8>) {
        out.extend(self.to_le_bytes());
    }

    fn of(bytes: &[u8]) -> Self {
        f32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]])
    }
}

impl<T: PackedNumber> Packed<T> {
    /// Characters that it takes in JSON, quotes included.
    pub fn characters(&self) -> usize {
        (self.0.len() * T::WIDTH).div_ceil(3) * 4 + 2
    }
}

impl Packed<f32> {
    /// Of doubles.
    pub fn of_doubles(values: impl IntoIterator<Item = f64>) -> Self {
        Packed(values.into_iter().map(|v| v as f32).collect())
    }
}

impl<T: PackedNumber> Serialize for Packed<T> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut bytes = Vec::with_capacity(self.0.len() * T::WIDTH);
        self.0.iter().for_each(|v| v.put(&mut bytes));
        serializer.serialize_str(&base64(&bytes))
    }
}

impl<'de, T: PackedNumber> Deserialize<'de> for Packed<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let text = String::deserialize(deserializer)?;
        let bytes = from_base64(&text).ok_or_else(|| serde::de::Error::custom("is no base64"))?;
        if !bytes.len().is_multiple_of(T::WIDTH) {
            let sentence = format!("holds {} bytes, which are no whole numbers of {} bytes", bytes.len(), T::WIDTH);
            return Err(serde::de::Error::custom(sentence));
        }
        Ok(Packed(bytes.chunks_exact(T::WIDTH).map(T::of).collect()))
    }
}

const DIGITS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";

/// RFC 4648, with padding.
pub fn base64(bytes: &[u8]) -> String {
    let mut out = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for chunk in bytes.chunks(3) {
        let word = chunk.iter().fold(0u32, |word, &b| (word << 8) | u32::from(b)) << (8 * (3 - chunk.len()));
        for digit in 0..4 {
            let index = (word >> (18 - 6 * digit)) & 63;
            out.push(if digit <= chunk.len() { DIGITS[index as usize] as char } else { '=' });
        }
    }
    out
}

/// Undoes [`base64`]; `None` for anything else.
fn from_base64(text: &str) -> Option<Vec<u8>> {
    let text = text.as_bytes();
    let digits = text.strip_suffix(b"==").or_else(|| text.strip_suffix(b"=")).unwrap_or(text);
    if !text.len().is_multiple_of(4) {
        return None;
    }
    let value = |digit: u8| match digit {
        b'A'..=b'Z' => Some(digit - b'A'),
        b'a'..=b'z' => Some(digit - b'a' + 26),
        b'0'..=b'9' => Some(digit - b'0' + 52),
        b'+' => Some(62),
        b'/' => Some(63),
        _ => None,
    };
    let mut out = Vec::with_capacity(digits.len() / 4 * 3 + 2);
    for chunk in digits.chunks(4) {
        let mut word = 0u32;
        for &digit in chunk {
            word = (word << 6) | u32::from(value(digit)?);
        }
        word <<= 6 * (4 - chunk.len());
        out.extend_from_slice(&word.to_be_bytes()[1..chunk.len()]);
    }
    Some(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Test vectors of RFC 4648, section 10.
    #[test]
    fn base64_equals_the_rfc() {
        for (plain, coded) in [
            ("", ""),
            ("f", "Zg=="),
            ("fo", "Zm8="),
            ("foo", "Zm9v"),
            ("foob", "Zm9vYg=="),
            ("fooba", "Zm9vYmE="),
            ("foobar", "Zm9vYmFy"),
        ] {
            assert_eq!(base64(plain.as_bytes()), coded);
            assert_eq!(from_base64(coded).unwrap(), plain.as_bytes());
        }
        for broken in ["Z", "Zg=", "Zg==Zg==", "Zm 9", "é==="] {
            assert_eq!(from_base64(broken), None, "{broken}");
        }
    }

    #[test]
    fn numbers_survive_json() {
        let numbers = Packed(vec![0.0f32, -1.5, f32::MAX, 1e-30]);
        let text = serde_json::to_string(&numbers).unwrap();
        assert_eq!(text.len(), numbers.characters());
        assert_eq!(serde_json::from_str::<Packed<f32>>(&text).unwrap(), numbers);
        let words = Packed(vec![0u16, 1, 65_535]);
        assert_eq!(serde_json::from_str::<Packed<u16>>(&serde_json::to_string(&words).unwrap()).unwrap(), words);
        let said = serde_json::from_str::<Packed<f32>>("\"Zm9v\"").unwrap_err().to_string();
        assert!(said.contains("3 bytes"), "{said}");
    }
}
