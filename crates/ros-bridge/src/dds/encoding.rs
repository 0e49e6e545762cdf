//! The adapters through which RustDDS hands over bytes instead of decoded messages.

use std::convert::Infallible;

use bytes::Bytes;
use ledger_gate::sample::{CDR_BE, CDR_LE, PL_CDR_BE, PL_CDR_LE, Sample};
use rustdds::{
    RepresentationIdentifier,
    no_key::{Decode, DefaultDecoder, DeserializerAdapter, SerializerAdapter},
};

use crate::error::Error;

/// Raw CDR of one encoding; `ID` is the second byte of its representation identifier (the first is 0).
pub(super) struct Raw<const ID: u8>;

/// Raw CDR of any encoding that we read.
pub(super) struct AnyRaw;

const READ: [RepresentationIdentifier; 4] = [
    RepresentationIdentifier::CDR_LE,
    RepresentationIdentifier::CDR_BE,
    RepresentationIdentifier::PL_CDR_LE,
    RepresentationIdentifier::PL_CDR_BE,
];

impl<const ID: u8> SerializerAdapter<Bytes> for Raw<ID> {
    type Error = Infallible;

    fn output_encoding() -> RepresentationIdentifier {
        match [0, ID] {
            CDR_BE => RepresentationIdentifier::CDR_BE,
            PL_CDR_BE => RepresentationIdentifier::PL_CDR_BE,
            PL_CDR_LE => RepresentationIdentifier::PL_CDR_LE,
            _ => RepresentationIdentifier::CDR_LE,
        }
    }

    fn to_bytes(body: &Bytes) -> Result<Bytes, Infallible> {
        Ok(body.clone())
    }
}

impl DeserializerAdapter<Sample> for AnyRaw {
    type Error = Error;
    type Decoded = Sample;

    fn supported_encodings() -> &'static [RepresentationIdentifier] {
        &READ
    }

    fn transform_decoded(decoded: Sample) -> Sample {
        decoded
    }
}

impl DefaultDecoder<Sample> for AnyRaw {
    type Decoder = Copying;
    const DECODER: Copying = Copying;
}

/// Puts the header back in front of the body, which RustDDS gives us without it.
#[derive(Clone)]
pub(super) struct Copying;

impl Decode<'_, Sample> for Copying {
    type Error = Error;

    fn decode_bytes(self, body: &[u8], encoding: RepresentationIdentifier) -> Result<Sample, Error> {
        let id = match encoding {
            RepresentationIdentifier::CDR_BE => CDR_BE,
            RepresentationIdentifier::PL_CDR_BE => PL_CDR_BE,
            RepresentationIdentifier::PL_CDR_LE => PL_CDR_LE,
            _ => CDR_LE,
        };
        Sample::new(id, body).map_err(Error::sample)
    }
}
