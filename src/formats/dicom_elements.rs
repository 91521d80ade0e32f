//! The data elements of a DICOM file in memory: a table of tags, whose values are slices of the file. Every length in
//! the file is compared with what is left of it before anything else is done with it, and nothing is allocated by it.
//!
//! After DICOM PS3.5 (2024), section 7, and PS3.10, section 7. Little endian, with explicit or implicit representation.
//! Values of sequences are walked over, not kept. Left out: big endian, deflated and compressed files, of which only
//! the meta information is read.

use crate::base::{Error, Result};

/// Group and element number.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Tag(pub u16, pub u16);

impl std::fmt::Display for Tag {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "({:04X},{:04X})", self.0, self.1)
    }
}

/// Bytes before the magic.
const PREAMBLE_BYTES: usize = 128;
const MAGIC: &[u8] = b"DICM";
/// Bytes that tell whether a file is DICOM.
pub const MAGIC_END: usize = PREAMBLE_BYTES + MAGIC.len();

/// The pixels, the last element that is read.
pub const PIXELS: Tag = Tag(0x7fe0, 0x0010);
const TRANSFER_SYNTAX: Tag = Tag(0x0002, 0x0010);
const IMPLICIT: &str = "1.2.840.10008.1.2";
const EXPLICIT: &str = "1.2.840.10008.1.2.1";
const ITEM: Tag = Tag(0xfffe, 0xe000);
const ITEM_END: Tag = Tag(0xfffe, 0xe00d);
const SEQUENCE_END: Tag = Tag(0xfffe, 0xe0dd);
/// The length of what ends with a delimiter.
const UNDEFINED: u32 = u32::MAX;
/// Representations with a length of four bytes.
const LONG: [&[u8; 2]; 13] =
    [b"OB", b"OD", b"OF", b"OL", b"OV", b"OW", b"SQ", b"SV", b"UC", b"UN", b"UR", b"UT", b"UV"];
/// Deepest that sequences lie in each other.
const MOST_DEPTH: usize = 64;

/// Where the elements begin behind the magic; `None` where the first bytes are not those of a DICOM file. The preamble
/// may be missing.
pub fn begin(start: &[u8]) -> Option<usize> {
    let at = |from: usize| start.get(from..from + MAGIC.len()) == Some(MAGIC);
    [PREAMBLE_BYTES, 0].into_iter().find(|&from| at(from)).map(|from| from + MAGIC.len())
}

/// How the values of an element are stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum ElementKind {
    /// Unsigned and signed words, longs, and floating point numbers.
    U16,
    I16,
    U32,
    I32,
    F32,
    F64,
    /// Everything else: text, or bytes.
    Text,
}

impl ElementKind {
    fn of(representation: [u8; 2]) -> Self {
        match &representation {
            b"US" => ElementKind::U16,
            b"SS" => ElementKind::I16,
            b"UL" => ElementKind::U32,
            b"SL" => ElementKind::I32,
            b"FL" => ElementKind::F32,
            b"FD" => ElementKind::F64,
            _ => ElementKind::Text,
        }
    }

    /// Of a tag whose file does not say it, as far as it is asked for: the numbers of group 28 that are no text.
    fn implied(tag: Tag) -> Self {
        match tag {
            Tag(0x0028, 0x0002 | 0x0010 | 0x0011 | 0x0100..=0x0103) => ElementKind::U16,
            _ => ElementKind::Text,
        }
    }
}

/// The outermost elements of a file, but for sequences.
pub struct Elements<'a> {
    found: Vec<(Tag, ElementKind, &'a [u8])>,
    /// How the elements are written; empty where the file does not say it.
    pub transfer_syntax: String,
}

impl<'a> Elements<'a> {
    /// The elements of `bytes`, a whole file in which they [`begin`] at `start`. Of a file that is neither of the two
    /// plain transfer syntaxes, those of the meta information.
    ///
    /// Errors name the element: a length beyond the end of the file, sequences that do not end or lie too deep in each
    /// other.
    pub fn read(bytes: &'a [u8], start: usize) -> Result<Self> {
        let mut walk = ElementWalk { bytes, at: start, explicit: true };
        let mut found = Vec::new();
        while walk.peek().is_some_and(|tag| tag.0 == 2) {
            walk.element(&mut found)?;
        }
        let of_syntax = found.iter().find(|(tag, ..)| *tag == TRANSFER_SYNTAX).map(|(_, _, value)| text_of(value));
        let transfer_syntax = of_syntax.unwrap_or_default();
        if [IMPLICIT, EXPLICIT].contains(&transfer_syntax.as_str()) {
            walk.explicit = transfer_syntax == EXPLICIT;
            // Nothing behind the pixels is wanted.
            while walk.at < bytes.len() && found.last().is_none_or(|(tag, ..)| *tag != PIXELS) {
                walk.element(&mut found)?;
            }
        }
        Ok(Elements { found, transfer_syntax })
    }

    /// Whether the elements behind the meta information could be read.
    pub fn is_plain(&self) -> bool {
        [IMPLICIT, EXPLICIT].contains(&self.transfer_syntax.as_str())
    }

    fn find(&self, tag: Tag) -> Option<(ElementKind, &'a [u8])> {
        self.found.iter().find(|(found, ..)| *found == tag).map(|(_, kind, value)| (*kind, *value))
    }

    /// The bytes of an element.
    pub fn bytes(&self, tag: Tag) -> Option<&'a [u8]> {
        self.find(tag).map(|(_, value)| value)
    }

    /// The text of an element, without what pads it.
    pub fn text(&self, tag: Tag) -> Option<String> {
        self.bytes(tag).map(text_of)
    }

    /// The numbers of an element; `None` where it is missing or holds something else.
    pub fn numbers(&self, tag: Tag) -> Option<Vec<f64>> {
        fn all<const N: usize>(value: &[u8], number: impl Fn([u8; N]) -> f64) -> Option<Vec<f64>> {
            let (whole, rest) = value.as_chunks::<N>();
            rest.is_empty().then(|| whole.iter().map(|bytes| number(*bytes)).collect())
        }
        let (kind, value) = self.find(tag)?;
        match kind {
            ElementKind::U16 => all(value, |b| u16::from_le_bytes(b).into()),
            ElementKind::I16 => all(value, |b| i16::from_le_bytes(b).into()),
            ElementKind::U32 => all(value, |b| u32::from_le_bytes(b).into()),
            ElementKind::I32 => all(value, |b| i32::from_le_bytes(b).into()),
            ElementKind::F32 => all(value, |b| f32::from_le_bytes(b).into()),
            ElementKind::F64 => all(value, f64::from_le_bytes),
            ElementKind::Text => text_of(value).split('\\').map(|word| word.trim().parse().ok()).collect(),
        }
    }
}

/// Text without the blanks and zeros around it.
fn text_of(value: &[u8]) -> String {
    String::from_utf8_lossy(value).trim_matches(['\0', ' ']).to_owned()
}

/// The head of an element.
struct ElementHead {
    tag: Tag,
    representation: [u8; 2],
    length: u32,
}

impl ElementHead {
    /// Whether the value is made of items.
    fn is_sequence(&self) -> bool {
        &self.representation == b"SQ" || self.length == UNDEFINED
    }
}

/// A place in a file.
struct ElementWalk<'a> {
    bytes: &'a [u8],
    at: usize,
    /// Whether elements say their representation.
    explicit: bool,
}

impl<'a> ElementWalk<'a> {
    /// The next `count` bytes.
    fn take(&mut self, count: usize, what: impl FnOnce() -> String) -> Result<&'a [u8]> {
        let end = self.at.checked_add(count).filter(|&end| end <= self.bytes.len());
        let Some(end) = end else {
            return Err(Error::input(format!("ends within {}", what())));
        };
        let taken = &self.bytes[self.at..end];
        self.at = end;
        Ok(taken)
    }

    fn word(&mut self) -> Result<u16> {
        let bytes = self.take(2, || "the head of an element".into())?;
        Ok(u16::from_le_bytes([bytes[0], bytes[1]]))
    }

    fn long(&mut self) -> Result<u32> {
        let bytes = self.take(4, || "the head of an element".into())?;
        Ok(u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]))
    }

    /// The tag that comes next.
    fn peek(&self) -> Option<Tag> {
        let bytes = self.bytes.get(self.at..self.at + 4)?;
        Some(Tag(u16::from_le_bytes([bytes[0], bytes[1]]), u16::from_le_bytes([bytes[2], bytes[3]])))
    }

    fn head(&mut self) -> Result<ElementHead> {
        let tag = Tag(self.word()?, self.word()?);
        if tag.0 == ITEM.0 || !self.explicit {
            return Ok(ElementHead { tag, representation: *b"  ", length: self.long()? });
        }
        let bytes = self.take(2, || "the head of an element".into())?;
        let representation = [bytes[0], bytes[1]];
        let length = if LONG.contains(&&representation) {
            self.word()?;
            self.long()?
        } else {
            u32::from(self.word()?)
        };
        Ok(ElementHead { tag, representation, length })
    }

    /// Takes an outermost element, and keeps it unless it is a sequence.
    fn element(&mut self, found: &mut Vec<(Tag, ElementKind, &'a [u8])>) -> Result<()> {
        let head = self.head()?;
        let ElementHead { tag, representation, length } = head;
        if length == UNDEFINED {
            return self.items(&head, 0);
        }
        let value = self.take(length as usize, || format!("DICOM tag {tag}, which has {length} bytes"))?;
        if !head.is_sequence() {
            let says = self.explicit && &representation != b"UN";
            let kind = if says { ElementKind::of(representation) } else { ElementKind::implied(tag) };
            found.push((tag, kind, value));
        }
        Ok(())
    }

    /// Walks over the items of a sequence of undefined length.
    fn items(&mut self, sequence: &ElementHead, depth: usize) -> Result<()> {
        let tag = sequence.tag;
        if depth > MOST_DEPTH {
            return Err(Error::input("holds sequences too deep in each other").element(format!("DICOM tag {tag}")));
        }
        // What is written without a known representation is implicit inside.
        let explicit = self.explicit;
        self.explicit = explicit && &sequence.representation != b"UN";
        loop {
            let item = self.head()?;
            match item.tag {
                SEQUENCE_END => break,
                ITEM if item.length != UNDEFINED => {
                    self.take(item.length as usize, || format!("an item of DICOM tag {tag}"))?;
                }
                ITEM => self.item(depth)?,
                other => {
                    let sentence = format!("holds DICOM tag {other} where an item is wanted");
                    return Err(Error::input(sentence).element(format!("DICOM tag {tag}")));
                }
            }
        }
        self.explicit = explicit;
        Ok(())
    }

    /// Walks over the elements of an item of undefined length.
    fn item(&mut self, depth: usize) -> Result<()> {
        loop {
            let head = self.head()?;
            match head.tag {
                ITEM_END => return Ok(()),
                _ if head.length == UNDEFINED => self.items(&head, depth + 1)?,
                tag => drop(self.take(head.length as usize, || format!("DICOM tag {tag}"))?),
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn head(tag: Tag, kind: &[u8; 2], length: u32) -> Vec<u8> {
        let mut bytes = [tag.0.to_le_bytes(), tag.1.to_le_bytes()].concat();
        if kind != b"  " {
            bytes.extend(kind);
        }
        if kind == b"  " {
            bytes.extend(length.to_le_bytes());
        } else if LONG.contains(&kind) {
            bytes.extend([0, 0]);
            bytes.extend(length.to_le_bytes());
        } else {
            bytes.extend((length as u16).to_le_bytes());
        }
        bytes
    }

    fn element(tag: Tag, kind: &[u8; 2], value: &[u8]) -> Vec<u8> {
        [head(tag, kind, value.len() as u32), value.to_vec()].concat()
    }

    /// A file of these elements.
    fn file(syntax: &str, elements: &[Vec<u8>]) -> Vec<u8> {
        [b"DICM".to_vec(), element(TRANSFER_SYNTAX, b"UI", syntax.as_bytes()), elements.concat()].concat()
    }

    fn read(bytes: &[u8]) -> Result<Elements<'_>> {
        Elements::read(bytes, begin(bytes).unwrap())
    }

    const ROWS: Tag = Tag(0x0028, 0x0010);
    const SEQUENCE: Tag = Tag(0x0008, 0x1140);

    #[test]
    fn values_are_read_in_both_representations_and_sequences_are_walked_over() {
        // Both kinds of ends, and a sequence in a sequence.
        let nested = |kind: &[u8; 2], inner: &[u8; 2]| {
            [
                head(SEQUENCE, kind, UNDEFINED),
                head(ITEM, b"  ", UNDEFINED),
                head(Tag(0x0008, 0x1199), inner, UNDEFINED),
                element(ITEM, b"  ", &[7; 10]),
                head(SEQUENCE_END, b"  ", 0),
                head(ITEM_END, b"  ", 0),
                element(ITEM, b"  ", &[]),
                head(SEQUENCE_END, b"  ", 0),
            ]
            .concat()
        };
        let explicit = file(
            EXPLICIT,
            &[
                nested(b"SQ", b"SQ"),
                nested(b"UN", b"  "),
                element(Tag(0x0009, 0x0010), b"SQ", &element(ITEM, b"  ", &[1; 6])),
                element(ROWS, b"US", &300u16.to_le_bytes()),
                element(Tag(0x0028, 0x1052), b"DS", b"-1024 "),
                element(Tag(0x0020, 0x0032), b"DS", b"1.5\\-2\\3e1"),
                element(Tag(0x0018, 0x9999), b"FD", &2.5f64.to_le_bytes()),
            ],
        );
        let read_explicit = read(&explicit).unwrap();
        assert_eq!(read_explicit.numbers(ROWS).unwrap(), [300.0]);
        assert_eq!(read_explicit.numbers(Tag(0x0028, 0x1052)).unwrap(), [-1024.0]);
        assert_eq!(read_explicit.numbers(Tag(0x0020, 0x0032)).unwrap(), [1.5, -2.0, 30.0]);
        assert_eq!(read_explicit.numbers(Tag(0x0018, 0x9999)).unwrap(), [2.5]);
        assert!(read_explicit.bytes(SEQUENCE).is_none() && read_explicit.is_plain());
        let implicit = file(IMPLICIT, &[nested(b"  ", b"  "), element(ROWS, b"  ", &300u16.to_le_bytes())]);
        assert_eq!(read(&implicit).unwrap().numbers(ROWS).unwrap(), [300.0]);
        let with_preamble = [vec![0; PREAMBLE_BYTES], implicit].concat();
        assert_eq!(begin(&with_preamble), Some(MAGIC_END));
        assert_eq!(begin(b"no DICM here"), None);
    }

    #[test]
    fn lengths_beyond_the_file_and_endless_sequences_are_refused() {
        let said = |elements: &[Vec<u8>]| read(&file(EXPLICIT, elements)).err().map(|e| e.to_string()).unwrap();
        assert_eq!(
            said(&[head(Tag(0x7fe0, 0x0010), b"OW", 4_000_000_000)]),
            "ends within DICOM tag (7FE0,0010), which has 4000000000 bytes"
        );
        assert_eq!(said(&[vec![8, 0, 0x60]]), "ends within the head of an element");
        assert!(said(&[head(SEQUENCE, b"SQ", UNDEFINED)]).contains("ends within"));
        assert!(said(&[head(SEQUENCE, b"SQ", UNDEFINED), element(ROWS, b"US", &[1, 0])]).contains("where an item"));
        let level = [head(SEQUENCE, b"SQ", UNDEFINED), head(ITEM, b"  ", UNDEFINED)].concat();
        assert!(said(&vec![level; 100_000]).contains("too deep"));
        // Of other transfer syntaxes only the meta information is read.
        let packed = file("1.2.840.10008.1.2.4.70", &[vec![1; 7]]);
        assert!(!read(&packed).unwrap().is_plain());
    }
}
