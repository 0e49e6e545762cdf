//! The samples of stream.py and stream.cpp.

use ledger_gate::sample::{CDR_LE, Sample};
use rustix::time::{ClockId, clock_gettime};

/// Where the data of an image begin, behind the header of the sample.
const DATA: usize = 48;

/// Numbers stand in a Twist divided by this, so that a gate lets them pass as speeds.
const NUMBERS: f64 = 1024.0;
/// The same of times in nanoseconds.
const NANOSECONDS: f64 = (1_u64 << 60) as f64;

/// The sample with this number, from now on under way: a Twist, or an image with `size` bytes of data.
pub(crate) fn streamed(number: u32, size: usize) -> Sample {
    let now = clock_gettime(ClockId::Monotonic);
    let now = now.tv_sec * 1_000_000_000 + now.tv_nsec;
    if size == 0 {
        #[expect(clippy::cast_precision_loss, reason = "microseconds of a hundred years")]
        let values = [f64::from(number) / NUMBERS, now as f64 / NANOSECONDS, 0.0, 0.0, 0.0, 0.0];
        return Sample::new(CDR_LE, &values.map(f64::to_le_bytes).concat()).unwrap();
    }
    let length = u32::try_from(size).unwrap();
    let mut body = vec![0; DATA];
    let mut put = |at: usize, bytes: &[u8]| body.get_mut(at..at + bytes.len()).unwrap().copy_from_slice(bytes);
    for (at, value) in [(0, number), (8, 7), (20, 1), (24, length), (28, 6), (40, length), (44, length)] {
        put(at, &value.to_le_bytes());
    }
    put(12, b"camera");
    put(32, b"mono8");
    body.extend(now.to_le_bytes());
    body.resize(DATA + size, u8::try_from(number % 251).unwrap());
    Sample::new(CDR_LE, &body).unwrap()
}

/// The number of a sample, which must be whole.
pub(crate) fn number_of(sample: &Sample, size: usize) -> u32 {
    let body = sample.body();
    if size == 0 {
        let value = f64::from_le_bytes(*body.first_chunk().unwrap());
        assert_eq!(body.len(), 48);
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "it was a number of a sample")]
        return (value * NUMBERS) as u32;
    }
    let number = u32::from_le_bytes(*body.first_chunk().unwrap());
    let fill = u8::try_from(number % 251).unwrap();
    let data = body.get(DATA + 8..DATA + size).expect("it is whole");
    assert!(data.iter().all(|byte| *byte == fill), "sample {number} is damaged");
    number
}
