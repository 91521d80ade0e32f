//! Arrays of numbers inside JSON: little-endian bytes in base64 (RFC 4648, with padding), which a page turns into a
//! typed array without parsing a digit.

use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::base::base64;

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
        serializer.serialize_str(&base64::encode(&bytes))
    }
}

impl<'de, T: PackedNumber> Deserialize<'de> for Packed<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let text = String::deserialize(deserializer)?;
        let bytes = base64::decode(&text).ok_or_else(|| serde::de::Error::custom("is no base64"))?;
        if !bytes.len().is_multiple_of(T::WIDTH) {
            let sentence = format!("holds {} bytes, which are no whole numbers of {} bytes", bytes.len(), T::WIDTH);
            return Err(serde::de::Error::custom(sentence));
        }
        Ok(Packed(bytes.chunks_exact(T::WIDTH).map(T::of).collect()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
