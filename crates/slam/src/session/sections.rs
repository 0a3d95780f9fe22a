//! [`SectionWriter`], [`SectionReader`]: named values in a row, each with a checksum.
//!
//! ```text
//! "garad session\n"  format u32      then, for every section,
//! length of the name u8, the name, length of the value u64, CRC-32 of name and value u32, the value
//! ```
//!
//! Numbers are little-endian. A value is encoded by postcard: integers as varints, floats as their
//! bits, no names of fields. So it can only be read by the program that wrote it, which is why
//! the format's number and the program's version stand in front. A value is decoded after its checksum has
//! been verified.

use std::io::{ErrorKind, Read, Write};

use serde::Serialize;
use serde::de::DeserializeOwned;

pub use super::error::{FORMAT, PROGRAM, SessionError};

/// The first bytes of a session.
const MAGIC: &[u8; 14] = b"garad session\n";

/// Writes sections, one after the other.
#[derive(Debug)]
pub struct SectionWriter<W> {
    out: W,
}

impl<W: Write> SectionWriter<W> {
    /// Begins a session.
    ///
    /// # Errors
    /// [`SessionError::Io`].
    pub fn new(mut out: W) -> Result<Self, SessionError> {
        out.write_all(MAGIC)?;
        out.write_all(&FORMAT.to_le_bytes())?;
        let mut writer = Self { out };
        writer.put("program", PROGRAM)?;
        Ok(writer)
    }

    /// Writes a value.
    ///
    /// # Errors
    /// [`SessionError::Io`]; [`SessionError::Value`] for a value without a form (none of ours).
    pub fn put<T: Serialize + ?Sized>(
        &mut self,
        name: &'static str,
        value: &T,
    ) -> Result<(), SessionError> {
        let bytes = postcard::to_stdvec(value).map_err(|source| SessionError::Value {
            section: name,
            source,
        })?;
        let length_of_name = u8::try_from(name.len()).unwrap_or(u8::MAX);
        self.out.write_all(&[length_of_name])?;
        self.out.write_all(name.as_bytes())?;
        self.out.write_all(&(bytes.len() as u64).to_le_bytes())?;
        self.out.write_all(&checksum(name, &bytes).to_le_bytes())?;
        self.out.write_all(&bytes)?;
        Ok(())
    }
}

/// Reads sections in the order in which they were written.
#[derive(Debug)]
pub struct SectionReader<R> {
    input: R,
}

impl<R: Read> SectionReader<R> {
    /// Begins to read a session.
    ///
    /// # Errors
    /// [`SessionError::Foreign`], [`SessionError::Format`] or [`SessionError::Program`] if it is none of
    /// this program's; [`SessionError::Truncated`]; [`SessionError::Io`].
    pub fn new(input: R) -> Result<Self, SessionError> {
        let mut reader = Self { input };
        let mut magic = [0; MAGIC.len()];
        match reader.fill("beginning", &mut magic) {
            Err(SessionError::Truncated { .. }) => return Err(SessionError::Foreign),
            other => other?,
        }
        if magic != *MAGIC {
            return Err(SessionError::Foreign);
        }
        let mut format = [0; 4];
        reader.fill("beginning", &mut format)?;
        let saved = u32::from_le_bytes(format);
        if saved != FORMAT {
            return Err(SessionError::Format { saved });
        }
        let saved: String = reader.take("program")?;
        if saved != PROGRAM {
            return Err(SessionError::Program { saved });
        }
        Ok(reader)
    }

    /// Reads the next value, which must have this name.
    ///
    /// # Errors
    /// [`SessionError::Truncated`], [`SessionError::Damaged`], [`SessionError::Value`], each with the
    /// section; [`SessionError::Io`].
    pub fn take<T: DeserializeOwned>(&mut self, name: &'static str) -> Result<T, SessionError> {
        let damaged = SessionError::Damaged { section: name };
        let mut length_of_name = [0];
        self.fill(name, &mut length_of_name)?;
        let mut found = vec![0; usize::from(length_of_name[0])];
        self.fill(name, &mut found)?;
        if found != name.as_bytes() {
            return Err(damaged);
        }
        let (mut length, mut expected) = ([0; 8], [0; 4]);
        self.fill(name, &mut length)?;
        self.fill(name, &mut expected)?;
        let length = u64::from_le_bytes(length);
        let mut bytes = Vec::new(); // grows with what is there, not with what is claimed
        (&mut self.input).take(length).read_to_end(&mut bytes)?;
        if (bytes.len() as u64) < length {
            return Err(SessionError::Truncated { section: name });
        }
        if checksum(name, &bytes) != u32::from_le_bytes(expected) {
            return Err(damaged);
        }
        match postcard::take_from_bytes(&bytes) {
            Ok((value, [])) => Ok(value),
            Ok(_) => Err(damaged),
            Err(source) => Err(SessionError::Value {
                section: name,
                source,
            }),
        }
    }

    fn fill(&mut self, section: &'static str, bytes: &mut [u8]) -> Result<(), SessionError> {
        self.input
            .read_exact(bytes)
            .map_err(|error| match error.kind() {
                ErrorKind::UnexpectedEof => SessionError::Truncated { section },
                _ => SessionError::Io(error),
            })
    }
}

fn checksum(name: &str, bytes: &[u8]) -> u32 {
    let mut hasher = crc32fast::Hasher::new();
    hasher.update(name.as_bytes());
    hasher.update(bytes);
    hasher.finalize()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn written() -> Vec<u8> {
        let mut bytes = Vec::new();
        let mut writer = SectionWriter::new(&mut bytes).expect("begun");
        writer
            .put("numbers", &[1.5f32, -0.0, f32::INFINITY])
            .expect("put");
        writer.put("word", "tie").expect("put");
        bytes
    }

    fn read(bytes: &[u8]) -> Result<(Vec<u32>, String), SessionError> {
        let mut reader = SectionReader::new(bytes)?;
        let numbers: [f32; 3] = reader.take("numbers")?;
        Ok((numbers.map(f32::to_bits).to_vec(), reader.take("word")?))
    }

    #[test]
    fn what_is_put_is_taken_bit_by_bit() {
        let (numbers, word) = read(&written()).expect("good");
        assert_eq!(numbers, [0x3fc0_0000, 0x8000_0000, 0x7f80_0000], "floats");
        assert_eq!(word, "tie", "text");
    }

    /// Byte by byte: 300 is the varint ac 02, and zlib gives CRC-32("n" ac 02).
    #[test]
    fn a_session_has_the_layout_it_is_said_to_have() {
        let mut bytes = Vec::new();
        let mut writer = SectionWriter::new(&mut bytes).expect("begun");
        writer.put("n", &300u32).expect("put");
        let [version, value] = [PROGRAM.as_bytes(), &[0xac, 0x02]];
        let mut expected = b"garad session\n".to_vec();
        expected.extend(FORMAT.to_le_bytes());
        expected.extend(b"\x07program");
        let length = u8::try_from(version.len()).expect("short");
        expected.extend([length + 1, 0, 0, 0, 0, 0, 0, 0]);
        let start = expected.len();
        expected.extend(&bytes[start..start + 4]); // the checksum of the version
        expected.push(length);
        expected.extend(version);
        expected.extend(b"\x01n");
        expected.extend([2, 0, 0, 0, 0, 0, 0, 0]);
        expected.extend(0x51b4_adf1_u32.to_le_bytes());
        expected.extend(value);
        assert_eq!(bytes, expected);
    }

    #[test]
    fn every_flipped_bit_and_every_cut_is_noticed() {
        let good = written();
        for i in 0..8 * good.len() {
            let mut bytes = good.clone();
            bytes[i / 8] ^= 1 << (i % 8);
            assert!(read(&bytes).is_err(), "bit {i}");
        }
        for n in 0..good.len() {
            assert!(read(&good[..n]).is_err(), "cut to {n}");
        }
    }

    #[test]
    fn foreign_files_and_other_versions_are_named() {
        for bytes in [&b""[..], b"garad", b"PNG or whatever else it is"] {
            assert!(
                matches!(read(bytes), Err(SessionError::Foreign)),
                "{bytes:?}"
            );
        }
        let mut newer = written();
        newer[MAGIC.len()] = 99;
        assert!(
            matches!(read(&newer), Err(SessionError::Format { saved: 99 })),
            "format"
        );
        let mut older = written();
        let at = MAGIC.len() + 4;
        let end = at + 1 + "program".len() + 12 + 1 + PROGRAM.len();
        let mut section = SectionWriter { out: Vec::new() };
        section.put("program", "0.0.0").expect("put");
        older.splice(at..end, section.out);
        match read(&older) {
            Err(SessionError::Program { saved }) => assert_eq!(saved, "0.0.0", "version"),
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn a_section_of_another_name_or_type_is_no_good() {
        let bytes = written();
        let mut reader = SectionReader::new(&bytes[..]).expect("begun");
        let other: Result<[f32; 3], _> = reader.take("letters");
        assert!(
            matches!(other, Err(SessionError::Damaged { section: "letters" })),
            "{other:?}"
        );
        let mut reader = SectionReader::new(&bytes[..]).expect("begun");
        let fewer: Result<[f32; 2], _> = reader.take("numbers");
        assert!(fewer.is_err(), "a number is left over");
        let mut reader = SectionReader::new(&bytes[..]).expect("begun");
        let more: Result<[f32; 4], _> = reader.take("numbers");
        assert!(more.is_err(), "a number is missing");
    }
}
