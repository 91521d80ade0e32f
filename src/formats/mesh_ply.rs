//! PLY (Turk 1994; ASCII, binary little- and big-endian): coordinates and faces, every other element and property is
//! skipped by its declared size. Own reader rather than `ply-rs-bw`: that one allocates what a header announces and
//! keeps a map per vertex; here a count is checked against the remaining bytes before anything is allocated.

use glam::DVec3;

use super::mesh_polygons::Fans;
use crate::base::{Error, Result, TriangleMesh};

#[derive(Clone, Copy, PartialEq)]
pub(super) enum Encoding {
    Ascii,
    Little,
    Big,
}

#[derive(Clone, Copy, PartialEq)]
pub(super) enum Number {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Number {
    fn parse(word: &str) -> Option<Number> {
        Some(match word {
            "char" | "int8" => Number::I8,
            "uchar" | "uint8" => Number::U8,
            "short" | "int16" => Number::I16,
            "ushort" | "uint16" => Number::U16,
            "int" | "int32" => Number::I32,
            "uint" | "uint32" => Number::U32,
            "float" | "float32" => Number::F32,
            "double" | "float64" => Number::F64,
            _ => return None,
        })
    }

    fn bytes(self) -> usize {
        match self {
            Number::I8 | Number::U8 => 1,
            Number::I16 | Number::U16 => 2,
            Number::I32 | Number::U32 | Number::F32 => 4,
            Number::F64 => 8,
        }
    }
}

pub(super) struct Property {
    pub name: String,
    pub number: Number,
    /// Type of the count when the property is a list.
    pub list: Option<Number>,
}

pub(super) struct Element {
    pub name: String,
    pub count: u64,
    pub properties: Vec<Property>,
}

/// Reads numbers one after the other.
pub(super) struct PlyBody<'a> {
    bytes: &'a [u8],
    encoding: Encoding,
    /// Says of the first record of a text that does not fill a line which it is: what is wrong later began there.
    uneven: Option<Error>,
}

/// How many numbers stand in a text.
fn numbers_in(text: &[u8]) -> usize {
    text.split(u8::is_ascii_whitespace).filter(|word| !word.is_empty()).count()
}

fn is_line_end(byte: &u8) -> bool {
    matches!(byte, b'\n' | b'\r')
}

impl<'a> PlyBody<'a> {
    /// Where a record begins.
    pub fn start_record(&mut self) -> &'a [u8] {
        if self.encoding == Encoding::Ascii {
            self.bytes = self.bytes.trim_ascii_start();
        }
        self.bytes
    }

    /// Notes a record of a text, read from `start` on, that does not fill a line; false when another one follows it in
    /// its line. Some programs wrap records, so that this is wrong only where something else is.
    pub fn end_record(&mut self, start: &'a [u8], name: impl FnOnce() -> String) -> bool {
        if self.encoding != Encoding::Ascii {
            return true;
        }
        let read = &start[..start.len() - self.bytes.len()];
        let next = self.bytes.iter().find(|b| is_line_end(b) || !b.is_ascii_whitespace());
        let ends_line = next.is_none_or(is_line_end);
        if self.uneven.is_none() && (!ends_line || read.iter().any(is_line_end)) {
            let line = start.split(is_line_end).next().unwrap_or_default();
            let (found, wanted) = (numbers_in(line), numbers_in(read));
            let message = format!("its line has {found} numbers, and the header's properties are {wanted}");
            self.uneven = Some(Error::input(message).element(name()));
        }
        ends_line
    }

    /// The record where a mistake began that was noticed later, or the mistake.
    pub fn first_mistake(&mut self, noticed: Error) -> Error {
        self.uneven.take().unwrap_or(noticed)
    }

    /// Reads over the elements that nobody wants, and demands that nothing but white space is left then.
    pub fn finish(&mut self, others: &[Element]) -> Result<()> {
        for element in others {
            self.expect_room(element)?;
            for index in 0..element.count {
                self.skip_record(element).ok_or_else(|| {
                    Error::input("the file ends here, or a number cannot be read")
                        .element(format!("{} {index}", element.name))
                })?;
            }
        }
        let left = self.bytes.iter().filter(|b| !b.is_ascii_whitespace()).count();
        if left == 0 {
            return Ok(());
        }
        let message = format!("{left} bytes follow the last element: the header names too few records or properties");
        Err(self.first_mistake(Error::input(message)))
    }

    fn skip_record(&mut self, element: &Element) -> Option<()> {
        for property in &element.properties {
            let count = property.list.map_or(Some(1.0), |count| self.next(count))?;
            for _ in 0..count.max(0.0) as u64 {
                self.next(property.number)?;
            }
        }
        Some(())
    }

    pub fn next(&mut self, number: Number) -> Option<f64> {
        if self.encoding == Encoding::Ascii {
            let start = self.bytes.iter().position(|b| !b.is_ascii_whitespace())?;
            let rest = &self.bytes[start..];
            let end = rest.iter().position(|b| b.is_ascii_whitespace()).unwrap_or(rest.len());
            self.bytes = &rest[end..];
            return std::str::from_utf8(&rest[..end]).ok()?.parse().ok();
        }
        let size = number.bytes();
        let mut raw = [0u8; 8];
        raw[..size].copy_from_slice(self.bytes.get(..size)?);
        self.bytes = &self.bytes[size..];
        if self.encoding == Encoding::Big {
            raw[..size].reverse();
        }
        let four = [raw[0], raw[1], raw[2], raw[3]];
        Some(match number {
            Number::I8 => raw[0] as i8 as f64,
            Number::U8 => raw[0] as f64,
            Number::I16 => i16::from_le_bytes([raw[0], raw[1]]) as f64,
            Number::U16 => u16::from_le_bytes([raw[0], raw[1]]) as f64,
            Number::I32 => i32::from_le_bytes(four) as f64,
            Number::U32 => u32::from_le_bytes(four) as f64,
            Number::F32 => f32::from_le_bytes(four) as f64,
            Number::F64 => f64::from_le_bytes(raw),
        })
    }

    /// An error when the header announces more records of `element` than the bytes that are left can hold. So the
    /// length of the file bounds the work.
    pub fn expect_room(&self, element: &Element) -> Result<()> {
        if element.count > 0 && element.properties.is_empty() {
            return Err(Error::input("has no property").element(format!("element {}", element.name)));
        }
        let announced = element.count.saturating_mul(self.least_bytes(element));
        // The last number of a text needs nothing behind it.
        if announced > self.bytes.len() as u64 + u64::from(self.encoding == Encoding::Ascii) {
            let (count, left) = (element.count, self.bytes.len());
            let message = format!("the header announces {count} of them, which {left} bytes cannot hold");
            return Err(Error::input(message).element(format!("element {}", element.name)));
        }
        Ok(())
    }

    /// The bytes that one record takes at least.
    fn least_bytes(&self, element: &Element) -> u64 {
        let binary = |p: &Property| p.list.unwrap_or(p.number).bytes() as u64;
        match self.encoding {
            Encoding::Ascii => 2 * element.properties.len() as u64,
            _ => element.properties.iter().map(binary).sum(),
        }
    }
}

/// Header and what follows it.
pub(super) fn parse_header(bytes: &[u8]) -> Result<(Vec<Element>, PlyBody<'_>)> {
    let mut rest = bytes;
    let mut elements: Vec<Element> = Vec::new();
    let mut encoding = None;
    for line_number in 1.. {
        let fail = |message: &str| Error::input(message).element(format!("header line {line_number}"));
        let end = rest.iter().take(4096).position(|&b| b == b'\n').ok_or_else(|| match line_number {
            1 => Error::input("the file does not begin with the word ply"),
            _ => fail("the header has no end_header"),
        })?;
        let line = std::str::from_utf8(&rest[..end]).map_err(|_| fail("is not text"))?;
        rest = &rest[end + 1..];
        let words: Vec<&str> = line.split_whitespace().collect();
        if line_number == 1 {
            if words != ["ply"] {
                return Err(Error::input("the file does not begin with the word ply"));
            }
            continue;
        }
        match words.as_slice() {
            ["format", "ascii", _] => encoding = Some(Encoding::Ascii),
            ["format", "binary_little_endian", _] => encoding = Some(Encoding::Little),
            ["format", "binary_big_endian", _] => encoding = Some(Encoding::Big),
            ["comment", ..] | ["obj_info", ..] | [] => {}
            ["element", name, count] => {
                let count = count.parse().map_err(|_| fail("the count of an element is not a number"))?;
                elements.push(Element { name: name.to_string(), count, properties: Vec::new() });
            }
            ["property", kind @ .., name] => {
                let unknown = || fail("unknown property type");
                let (list, number) = match kind {
                    [number] => (None, Number::parse(number).ok_or_else(unknown)?),
                    ["list", count, number] => {
                        (Some(Number::parse(count).ok_or_else(unknown)?), Number::parse(number).ok_or_else(unknown)?)
                    }
                    _ => return Err(unknown()),
                };
                let element = elements.last_mut().ok_or_else(|| fail("a property stands before any element"))?;
                element.properties.push(Property { name: name.to_string(), number, list });
            }
            ["end_header"] => {
                let encoding = encoding.ok_or_else(|| Error::input("the header names no format"))?;
                return Ok((elements, PlyBody { bytes: rest, encoding, uneven: None }));
            }
            _ => return Err(fail("cannot be understood")),
        }
    }
    unreachable!("every round of the loop uses up a line of a finite header")
}

/// Where x, y and z stand among the properties of the vertex.
fn coordinate_places(element: &Element) -> Result<[usize; 3]> {
    let place = |name: &str| {
        let found = element.properties.iter().position(|p| p.name == name && p.list.is_none());
        found.ok_or_else(|| Error::input(format!("has no property {name}")).element("element vertex"))
    };
    Ok([place("x")?, place("y")?, place("z")?])
}

fn is_face_list(property: &Property) -> bool {
    property.list.is_some() && matches!(property.name.as_str(), "vertex_indices" | "vertex_index")
}

/// The mesh in the bytes of a PLY file; the caller validates it.
pub(super) fn parse(bytes: &[u8]) -> Result<TriangleMesh> {
    let (elements, mut body) = parse_header(bytes)?;
    let mesh = parse_body(&elements, &mut body).map_err(|e| body.first_mistake(e))?;
    body.finish(&[])?;
    Ok(mesh)
}

fn parse_body(elements: &[Element], body: &mut PlyBody<'_>) -> Result<TriangleMesh> {
    let (mut mesh, mut fans) = (TriangleMesh::default(), Fans::default());
    for element in elements {
        body.expect_room(element)?;
        let coordinates = if element.name == "vertex" { Some(coordinate_places(element)?) } else { None };
        if element.name == "face" && !element.properties.iter().any(is_face_list) {
            return Err(Error::input("has no list vertex_indices").element("element face"));
        }
        for index in 0..element.count {
            let named = |message: String| Error::input(message).element(format!("{} {index}", element.name));
            let broken = || named("the file ends here, or a number cannot be read".into());
            let start = body.start_record();
            let mut record = [0.0; 3];
            for (place, property) in element.properties.iter().enumerate() {
                let Some(count_type) = property.list else {
                    let value = body.next(property.number).ok_or_else(broken)?;
                    if let Some(axis) = coordinates.and_then(|c| c.iter().position(|&p| p == place)) {
                        record[axis] = value;
                    }
                    continue;
                };
                let count = body.next(count_type).ok_or_else(broken)?;
                let corners = element.name == "face" && is_face_list(property);
                let is_count = count >= if corners { 3.0 } else { 0.0 } && count.fract() == 0.0;
                if !is_count {
                    return Err(named(format!("has {count} {}", if corners { "corners" } else { "values in a list" })));
                }
                let (mut fan, first) = ([0u32; 2], mesh.faces.len());
                for corner in 0..count as u64 {
                    let value = body.next(property.number).ok_or_else(broken)?;
                    if !corners {
                        continue;
                    }
                    if value < 0.0 || value.fract() != 0.0 || value > u32::MAX as f64 {
                        return Err(named(format!("names vertex {value}")));
                    }
                    match corner {
                        0 | 1 => fan[corner as usize] = value as u32,
                        _ => {
                            mesh.faces.push([fan[0], fan[1], value as u32]);
                            fan[1] = value as u32;
                        }
                    }
                }
                fans.add(&mesh, first, index as usize);
            }
            body.end_record(start, || format!("{} {index}", element.name));
            if coordinates.is_some() {
                mesh.vertices.push(DVec3::from_array(record));
            }
        }
    }
    fans.settle(&mut mesh, "face")?;
    Ok(mesh)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Found by fuzzing: an element that takes no bytes may announce any number of records.
    #[test]
    fn an_element_without_properties_is_refused_at_once() {
        let text = "ply\nformat binary_little_endian 1.0\nelement nothing 18446744073709551615\nend_header\n";
        assert_eq!(parse(text.as_bytes()).unwrap_err().to_string(), "element nothing: has no property");
        let empty = text.replace("18446744073709551615", "0");
        assert!(parse(empty.as_bytes()).is_ok(), "none of them is no harm");
    }

    #[test]
    fn the_last_number_of_a_text_needs_no_line_end() {
        let head = "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n";
        assert_eq!(parse(format!("{head}end_header\n1 2 3").as_bytes()).unwrap().vertices, [DVec3::new(1., 2., 3.)]);
        assert!(parse(format!("{head}end_header\n1 2").as_bytes()).is_err());
    }

    /// Records may wrap or share a line; but what is wrong in the end began where one does not fit its line.
    #[test]
    fn a_line_that_does_not_fit_the_header_is_named() {
        let head = "ply\r\nformat ascii 1.0\ncomment by hand\nobj_info 1\nelement vertex 3\nproperty float x\n\
                    property float y\nproperty float z\nelement face 1\nproperty list uchar int vertex_indices\n\
                    element edge 1\nproperty int vertex1\nproperty list int int more\nend_header\n";
        let read = |body: &str| parse(format!("{head}{body}").as_bytes()).map_err(|e| e.to_string());
        let good = read("0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n5 2 6 7\n").unwrap();
        for same in [
            "0 0 0 \t\r\n1 0 0\r\n\r\n0 1 0\r\n3 0 1 2 \r\n5 2 6 7\r\n \n",
            "0 0\n0\n1 0 0\n0 1 0\n3 0\n1 2\n5 2 6 7",
            "0 0 0 1 0 0 0 1 0 3 0 1 2 5 2 6 7",
        ] {
            assert_eq!(read(same).unwrap(), good, "{same:?}");
        }
        for (body, says) in [
            ("0 0 0\n1 0 0 9\n0 1 0\n3 0 1 2\n5 2 6 7\n", "vertex 1: its line has 4 numbers"),
            (
                "0 0 0\n1 0\n0 1 0\n3 0 1 2\n5 2 6 7\n",
                "vertex 1: its line has 2 numbers, and the header's properties are 3",
            ),
            (
                "0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n5 2 6 7 8\n",
                "edge 0: its line has 5 numbers, and the header's properties are 4",
            ),
            ("0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n5 2 6 7\n8\n", "1 bytes follow the last element"),
        ] {
            let said = read(body).unwrap_err();
            assert!(said.starts_with(says), "{said}");
        }
    }
}
