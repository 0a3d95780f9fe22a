//! [`HeaderParser`]: the Python dict at the start of a `.npy` file.

use super::error::NpyError;

/// numpy's own limit on dimensions.
const MAX_DIMENSIONS: usize = 32;

/// Reads `{'descr': '<f8', 'fortran_order': False, 'shape': (3, 4), }`, keys in any order.
pub(super) struct HeaderParser<'a> {
    header: &'a [u8],
    at: usize,
}

impl<'a> HeaderParser<'a> {
    pub(super) fn new(header: &'a [u8]) -> Self {
        Self { header, at: 0 }
    }

    pub(super) fn parse(mut self) -> Result<(&'a str, bool, Vec<usize>), NpyError> {
        let (mut descr, mut fortran_order, mut shape) = (None, None, None);
        self.expect(b'{', "{")?;
        while !self.take(b'}') {
            let key = self.string()?;
            self.expect(b':', ":")?;
            match key {
                "descr" if descr.is_none() => descr = Some(self.string()?),
                "fortran_order" if fortran_order.is_none() => fortran_order = Some(self.boolean()?),
                "shape" if shape.is_none() => shape = Some(self.shape()?),
                _ => return Err(self.expected("descr, fortran_order or shape, each once")),
            }
            if !self.take(b',') && self.peek() != Some(b'}') {
                return Err(self.expected(", or }"));
            }
        }
        if self.peek().is_some() {
            return Err(self.expected("nothing but blanks after }"));
        }
        match (descr, fortran_order, shape) {
            (Some(descr), Some(fortran_order), Some(shape)) => Ok((descr, fortran_order, shape)),
            _ => Err(self.expected("descr, fortran_order and shape before the end")),
        }
    }

    fn expected(&self, expected: &'static str) -> NpyError {
        NpyError::Header {
            expected,
            at: self.at,
        }
    }

    /// The next byte that is not blank.
    fn peek(&mut self) -> Option<u8> {
        while let Some(b' ' | b'\n' | b'\t' | b'\r') = self.header.get(self.at) {
            self.at += 1;
        }
        self.header.get(self.at).copied()
    }

    fn take(&mut self, byte: u8) -> bool {
        let found = self.peek() == Some(byte);
        self.at += usize::from(found);
        found
    }

    fn expect(&mut self, byte: u8, name: &'static str) -> Result<(), NpyError> {
        if self.take(byte) {
            Ok(())
        } else {
            Err(self.expected(name))
        }
    }

    /// Bytes from here on for which `accept` holds.
    fn run(&mut self, accept: fn(&u8) -> bool) -> &'a str {
        let start = self.at;
        self.at += self.header[start..]
            .iter()
            .take_while(|b| accept(b))
            .count();
        std::str::from_utf8(&self.header[start..self.at]).unwrap_or_default()
    }

    fn string(&mut self) -> Result<&'a str, NpyError> {
        self.expect(b'\'', "'")?;
        let text = self.run(|&b| b.is_ascii_graphic() && b != b'\'' && b != b'\\');
        self.expect(b'\'', "'")?;
        Ok(text)
    }

    fn boolean(&mut self) -> Result<bool, NpyError> {
        self.peek();
        match self.run(u8::is_ascii_alphabetic) {
            "True" => Ok(true),
            "False" => Ok(false),
            _ => Err(self.expected("True or False")),
        }
    }

    /// `()`, `(3,)`, `(3, 4)`.
    fn shape(&mut self) -> Result<Vec<usize>, NpyError> {
        let mut shape = Vec::new();
        self.expect(b'(', "(")?;
        while !self.take(b')') {
            self.peek();
            let size = self.run(u8::is_ascii_digit).parse();
            shape.push(size.map_err(|_| self.expected("a size"))?);
            if shape.len() > MAX_DIMENSIONS {
                return Err(self.expected("at most 32 dimensions"));
            }
            if !self.take(b',') && self.peek() != Some(b')') {
                return Err(self.expected(", or )"));
            }
        }
        Ok(shape)
    }
}
