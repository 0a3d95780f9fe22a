//! The state of a session. The checksum of every section is made right first: what is decoded is as hostile
//! as the input. What was loaded is the same when saved and loaded again. It need not make sense, and is not
//! used (decision 008).

#![no_main]

use garad::run::{Run, RunOptions};
use garad::slam::Slam;
use garad::slam::session::SectionReader;
use garad_core::{Camera, Par};
use garad_fuzz::{check_line, within_mib};
use libfuzzer_sys::fuzz_target;

/// Magic and format.
const HEADER: usize = 18;
const MIB: usize = 256;

/// The input with the checksum of each section that is whole made right.
fn with_checksums(data: &[u8]) -> Vec<u8> {
    let mut session = data.to_vec();
    let mut at = HEADER;
    while let Some(length_of_name) = session.get(at) {
        let name = at + 1..at + 1 + usize::from(*length_of_name);
        let (length, sum) = (name.end..name.end + 8, name.end + 8..name.end + 12);
        let Some(bytes) = session.get(length) else {
            break;
        };
        let length = u64::from_le_bytes(bytes.try_into().expect("eight bytes"));
        let end = usize::try_from(length)
            .ok()
            .and_then(|n| n.checked_add(sum.end));
        let Some(end) = end.filter(|end| *end <= session.len()) else {
            break;
        };
        let mut hasher = crc32fast::Hasher::new();
        hasher.update(&session[name]);
        hasher.update(&session[sum.end..end]);
        session[sum].copy_from_slice(&hasher.finalize().to_le_bytes());
        at = end;
    }
    session
}

/// Whether the images of the session are large: tables of their size are made at once.
fn is_large(session: &[u8]) -> bool {
    let camera = SectionReader::new(session).and_then(|mut from| from.take::<Camera>("camera"));
    camera.is_ok_and(|camera| camera.width.max(camera.height) > 256)
}

fn saved(slam: &mut Slam) -> Vec<u8> {
    let mut bytes = Vec::new();
    slam.save(&mut bytes).expect("a state that was read");
    bytes
}

fuzz_target!(|data: &[u8]| {
    let session = with_checksums(data);
    if is_large(&session) {
        return;
    }
    let read = |mut bytes: &[u8]| within_mib(MIB, || Slam::load(&mut bytes, Par::Seq));
    let mut slam = match read(&session) {
        Ok(slam) => slam,
        Err(error) => return check_line(&error.to_string(), ""),
    };
    let first = saved(&mut slam);
    let mut again = read(&first).expect("what was written");
    assert!(saved(&mut again) == first, "round trip");

    let options = RunOptions {
        config: slam.config().clone(),
        threads: 1,
        seed: slam.seed(),
        strict: false,
        quiet: true,
    };
    let run = within_mib(MIB, || {
        Run::resume(&mut &session[..], slam.camera(), &options)
    });
    if let Err(error) = run {
        check_line(&format!("{error:#}"), "");
    }
});
