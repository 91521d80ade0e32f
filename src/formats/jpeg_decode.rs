//! What a viewer shows of the baseline JPEGs that `jpeg.rs` writes (ITU-T T.81): Huffman codes, dequantisation, inverse
//! cosine transform, colour at half the resolution interpolated linearly, YCbCr of JFIF to RGB. In double precision and
//! without SIMD, so that equal bytes are equal pictures on every machine. Left out: progressive and arithmetic coding,
//! restart intervals, 12 bits, other numbers of channels.

use crate::base::{Error, Image, Result};

/// Order in which the coefficients of a block are stored.
const ZIGZAG: [usize; 64] = [
    0, 1, 8, 16, 9, 2, 3, 10, 17, 24, 32, 25, 18, 11, 4, 5, 12, 19, 26, 33, 40, 48, 41, 34, 27, 20, 13, 6, 7, 14, 21,
    28, 35, 42, 49, 56, 57, 50, 43, 36, 29, 22, 15, 23, 30, 37, 44, 51, 58, 59, 52, 45, 38, 31, 39, 46, 53, 60, 61, 54,
    47, 55, 62, 63,
];
/// Most pixels of a picture.
const MOST_PIXELS: usize = 1 << 26;

fn damaged(what: &str) -> Error {
    Error::input(format!("is no JPEG that can be read: {what}"))
}

/// The RGB picture of a baseline JPEG of three channels. Errors: damage, or a kind that this reader does not know.
pub fn decode_rgb(bytes: &[u8]) -> Result<Image<u8>> {
    if bytes.get(..2) != Some(&[0xff, 0xd8]) {
        return Err(damaged("it does not begin like one"));
    }
    let mut picture = CodedPicture::default();
    let mut at = 2;
    loop {
        let Some([0xff, kind]) = bytes.get(at..at + 2) else { return Err(damaged("it is cut off")) };
        if *kind == 0xd9 {
            return picture.shown();
        }
        let length = bytes.get(at + 2..at + 4).map_or(0, |b| usize::from(u16::from_be_bytes([b[0], b[1]])));
        let body = bytes.get(at + 4..at + 2 + length).ok_or_else(|| damaged("a segment is cut off"))?;
        at += 2 + length;
        match kind {
            0xdb => picture.quantisation(body)?,
            0xc0 | 0xc1 => picture.frame(body)?,
            0xc4 => picture.huffman(body)?,
            0xda => at += picture.scan(body, &bytes[at..])?,
            0xe0..=0xef | 0xfe => {}
            _ => return Err(damaged("it has a segment that baseline pictures lack")),
        }
    }
}

/// What the header says of one channel.
#[derive(Clone, Copy)]
struct CodedChannel {
    id: u8,
    /// Blocks in a unit, across and down.
    sampling: [usize; 2],
    quantisation: usize,
}

/// Codes of each length in order, and what they stand for.
#[derive(Clone, Default)]
struct HuffmanTable {
    counts: [u16; 16],
    symbols: Vec<u8>,
}

/// What has been read so far.
#[derive(Default)]
struct CodedPicture {
    width: usize,
    height: usize,
    channels: Vec<CodedChannel>,
    /// The channels at their own resolution, whole units wide; and whether each has been read.
    planes: Vec<Image<f64>>,
    read: Vec<bool>,
    quantisation: [Option<[u16; 64]>; 4],
    /// For the first coefficient of a block, and for the others.
    huffman: [[HuffmanTable; 4]; 2],
}

impl CodedPicture {
    fn quantisation(&mut self, mut body: &[u8]) -> Result<()> {
        while let Some((&head, rest)) = body.split_first() {
            let wide = usize::from(head >> 4);
            let values =
                rest.get(..64 * (wide + 1)).filter(|_| wide < 2).ok_or_else(|| damaged("a table is cut off"))?;
            let slot =
                self.quantisation.get_mut(usize::from(head & 15)).ok_or_else(|| damaged("a table has no place"))?;
            let mut table = [0u16; 64];
            for (k, &place) in ZIGZAG.iter().enumerate() {
                table[place] = match wide {
                    0 => u16::from(values[k]),
                    _ => u16::from_be_bytes([values[2 * k], values[2 * k + 1]]),
                };
            }
            *slot = Some(table);
            body = &rest[64 * (wide + 1)..];
        }
        Ok(())
    }

    fn frame(&mut self, body: &[u8]) -> Result<()> {
        if body.len() != 6 + 3 * 3 || (body[0], body[5]) != (8, 3) || !self.channels.is_empty() {
            return Err(damaged("it has not three channels of 8 bits"));
        }
        let side = |k: usize| usize::from(u16::from_be_bytes([body[k], body[k + 1]]));
        (self.height, self.width) = (side(1), side(3));
        if self.width == 0 || self.height == 0 || self.width * self.height > MOST_PIXELS {
            return Err(damaged("its size cannot be"));
        }
        let channel = |c: &[u8]| CodedChannel {
            id: c[0],
            sampling: [usize::from(c[1] >> 4), usize::from(c[1] & 15)],
            quantisation: usize::from(c[2]),
        };
        self.channels = body[6..].chunks_exact(3).map(channel).collect();
        if !self.channels.iter().all(|c| c.sampling.iter().all(|s| [1, 2].contains(s))) {
            return Err(damaged("its channels are sampled in an unusual way"));
        }
        let units = self.units();
        let plane =
            |c: &CodedChannel| Image::filled(8 * c.sampling[0] * units[0], 8 * c.sampling[1] * units[1], 1, 0.0);
        self.planes = self.channels.iter().map(plane).collect();
        self.read = vec![false; 3];
        Ok(())
    }

    fn huffman(&mut self, mut body: &[u8]) -> Result<()> {
        while let Some((&head, rest)) = body.split_first() {
            let counts = rest.get(..16).ok_or_else(|| damaged("a table is cut off"))?;
            let total = counts.iter().map(|&c| usize::from(c)).sum::<usize>();
            let symbols = rest.get(16..16 + total).ok_or_else(|| damaged("a table is cut off"))?;
            let (class, slot) = (usize::from(head >> 4), usize::from(head & 15));
            let table = self.huffman.get_mut(class).and_then(|t| t.get_mut(slot));
            let table = table.ok_or_else(|| damaged("a table has no place"))?;
            for (own, &count) in table.counts.iter_mut().zip(counts) {
                *own = u16::from(count);
            }
            table.symbols = symbols.to_vec();
            body = &rest[16 + total..];
        }
        Ok(())
    }

    /// Most samples of a unit, across and down.
    fn most(&self) -> [usize; 2] {
        [0, 1].map(|k| self.channels.iter().map(|c| c.sampling[k]).max().unwrap_or(1))
    }

    /// Units across and down.
    fn units(&self) -> [usize; 2] {
        let most = self.most();
        [self.width.div_ceil(8 * most[0]), self.height.div_ceil(8 * most[1])]
    }

    /// Reads a scan, of one channel or of all together, from `codes`; gives the number of bytes that it takes.
    fn scan(&mut self, body: &[u8], codes: &[u8]) -> Result<usize> {
        let count = body.first().copied().map_or(0, usize::from);
        if ![1, 3].contains(&count) || body.len() != 4 + 2 * count || self.channels.is_empty() {
            return Err(damaged("its channels are stored in an unusual way"));
        }
        let mut members = Vec::new();
        for c in body[1..1 + 2 * count].chunks_exact(2) {
            let place = self.channels.iter().position(|channel| channel.id == c[0]);
            let place = place.ok_or_else(|| damaged("a scan names another channel"))?;
            let tables = [usize::from(c[1] >> 4), usize::from(c[1] & 15)];
            if tables.iter().any(|&t| t > 3) {
                return Err(damaged("a table has no place"));
            }
            members.push((place, tables));
        }
        let (units, most) = (self.units(), self.most());
        let cosines = cosines();
        let mut bits = CodeBits { codes, at: 0, held: 0, count: 0 };
        let mut first = [0i32; 3];
        if let [(channel, tables)] = members[..] {
            // Alone, a channel has only the blocks that the picture needs, row by row.
            let [across, down] = [(0, self.width), (1, self.height)]
                .map(|(k, side)| side.div_ceil(8).div_ceil(most[k] / self.channels[channel].sampling[k]));
            for block in 0..across * down {
                let values = self.block(channel, tables, &mut bits, &mut first[channel])?;
                let place = [8 * (block % across), 8 * (block / across)];
                write_block(&mut self.planes[channel], place, &inverse(&values, &cosines));
            }
            self.read[channel] = true;
            return Ok(bits.at);
        }
        for unit in 0..units[0] * units[1] {
            for &(channel, tables) in &members {
                let [across, down] = self.channels[channel].sampling;
                for block in 0..across * down {
                    let values = self.block(channel, tables, &mut bits, &mut first[channel])?;
                    let place = [
                        8 * ((unit % units[0]) * across + block % across),
                        8 * ((unit / units[0]) * down + block / across),
                    ];
                    write_block(&mut self.planes[channel], place, &inverse(&values, &cosines));
                }
                self.read[channel] = true;
            }
        }
        Ok(bits.at)
    }

    /// The dequantised coefficients of the next block.
    fn block(&self, channel: usize, tables: [usize; 2], bits: &mut CodeBits<'_>, first: &mut i32) -> Result<[f64; 64]> {
        let table = self.quantisation.get(self.channels[channel].quantisation).and_then(|t| t.as_ref());
        let table = table.ok_or_else(|| damaged("a table is missing"))?;
        let [of_first, of_others] = [0, 1].map(|class| &self.huffman[class][tables[class]]);
        let mut values = [0.0; 64];
        let length = bits.symbol(of_first)?;
        *first = first.saturating_add(bits.signed(length)?);
        values[0] = f64::from(*first) * f64::from(table[0]);
        let mut k = 1;
        while k < 64 {
            let symbol = bits.symbol(of_others)?;
            let (run, length) = (usize::from(symbol >> 4), symbol & 15);
            match (run, length) {
                (15, 0) => k += 16,
                (_, 0) => break,
                _ => {
                    k += run;
                    let place = *ZIGZAG.get(k).ok_or_else(|| damaged("a block is too long"))?;
                    values[place] = f64::from(bits.signed(length)?) * f64::from(table[place]);
                    k += 1;
                }
            }
        }
        Ok(values)
    }

    /// The channels at full resolution, as RGB.
    fn shown(&self) -> Result<Image<u8>> {
        if self.read.len() != 3 || self.read.contains(&false) {
            return Err(damaged("a channel is missing"));
        }
        let most = self.most();
        let sides = [self.width, self.height];
        let mut image = Image::filled(self.width, self.height, 3, 0u8);
        for (p, pixel) in image.data.chunks_exact_mut(3).enumerate() {
            let place = [p % self.width, p / self.width];
            let [luma, blue, red] = [0, 1, 2].map(|k| {
                let factor = [0, 1].map(|d| most[d] / self.channels[k].sampling[d]);
                // Colour was averaged over blocks of pixels: its samples lie in their middles.
                let at = [0, 1].map(|d| {
                    let last = sides[d].div_ceil(factor[d]) - 1;
                    ((place[d] as f64 + 0.5) / factor[d] as f64 - 0.5).clamp(0.0, last as f64)
                });
                sampled(&self.planes[k], at)
            });
            let (blue, red) = (blue - 128.0, red - 128.0);
            let rgb = [luma + 1.402 * red, luma - 0.344_136 * blue - 0.714_136 * red, luma + 1.772 * blue];
            pixel.copy_from_slice(&rgb.map(|v| v.round().clamp(0.0, 255.0) as u8));
        }
        Ok(image)
    }
}

fn write_block(plane: &mut Image<f64>, [x, y]: [usize; 2], block: &[f64; 64]) {
    for (row, values) in block.chunks_exact(8).enumerate() {
        let start = (y + row) * plane.width + x;
        plane.data[start..start + 8].copy_from_slice(values);
    }
}

/// The plane between its samples, linearly.
fn sampled(plane: &Image<f64>, [x, y]: [f64; 2]) -> f64 {
    let (left, top) = (x.floor() as usize, y.floor() as usize);
    let (right, bottom) = ((left + 1).min(plane.width - 1), (top + 1).min(plane.height - 1));
    let (s, t) = (x - left as f64, y - top as f64);
    let at = |x: usize, y: usize| plane.data[y * plane.width + x];
    let upper = at(left, top) * (1.0 - s) + at(right, top) * s;
    let lower = at(left, bottom) * (1.0 - s) + at(right, bottom) * s;
    upper * (1.0 - t) + lower * t
}

/// Row u, column x: C(u) / 2 cos((2 x + 1) u pi / 16).
fn cosines() -> [[f64; 8]; 8] {
    std::array::from_fn(|u| {
        let size = if u == 0 { 0.125f64.sqrt() } else { 0.5 };
        std::array::from_fn(|x| size * ((2 * x + 1) as f64 * u as f64 * std::f64::consts::PI / 16.0).cos())
    })
}

/// The inverse cosine transform, rows then columns, about the middle grey.
fn inverse(values: &[f64; 64], cosines: &[[f64; 8]; 8]) -> [f64; 64] {
    let mut rows = [0.0; 64];
    for v in 0..8 {
        for x in 0..8 {
            rows[8 * v + x] = (0..8).map(|u| values[8 * v + u] * cosines[u][x]).sum();
        }
    }
    std::array::from_fn(|place| {
        let (y, x) = (place / 8, place % 8);
        let sum: f64 = (0..8).map(|v| rows[8 * v + x] * cosines[v][y]).sum();
        (sum + 128.0).clamp(0.0, 255.0)
    })
}

/// The bits of a scan, in order.
struct CodeBits<'a> {
    codes: &'a [u8],
    at: usize,
    held: u32,
    count: u32,
}

impl CodeBits<'_> {
    fn bit(&mut self) -> Result<u32> {
        if self.count == 0 {
            let next = *self.codes.get(self.at).ok_or_else(|| damaged("its codes are cut off"))?;
            self.at += 1;
            if next == 0xff {
                // A stuffed zero follows a byte of ones; anything else is the end.
                if self.codes.get(self.at) != Some(&0) {
                    return Err(damaged("its codes are cut off"));
                }
                self.at += 1;
            }
            (self.held, self.count) = (u32::from(next), 8);
        }
        self.count -= 1;
        Ok(self.held >> self.count & 1)
    }

    fn symbol(&mut self, table: &HuffmanTable) -> Result<u8> {
        let (mut code, mut first, mut index) = (0u32, 0u32, 0usize);
        for &count in &table.counts {
            code |= self.bit()?;
            let count = u32::from(count);
            if code < first + count {
                let place = index + code.wrapping_sub(first) as usize;
                return table.symbols.get(place).copied().ok_or_else(|| damaged("a code stands for nothing"));
            }
            index += count as usize;
            first = (first + count) << 1;
            code <<= 1;
        }
        Err(damaged("a code stands for nothing"))
    }

    /// A number of `length` bits, negative where its first bit is 0.
    fn signed(&mut self, length: u8) -> Result<i32> {
        if length > 15 {
            return Err(damaged("a coefficient is too long"));
        }
        let mut value = 0i32;
        for _ in 0..length {
            value = value << 1 | self.bit()? as i32;
        }
        let half = if length == 0 { 0 } else { 1 << (length - 1) };
        Ok(if value < half { value - (1 << length) + 1 } else { value })
    }
}
