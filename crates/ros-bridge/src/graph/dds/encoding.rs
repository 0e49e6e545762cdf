//! The adapters through which RustDDS hands over bytes instead of decoded messages.

use std::convert::Infallible;

use bytes::Bytes;
use ledger_gate::sample::Sample;
use rustdds::{
    RepresentationIdentifier,
    no_key::{Decode, DefaultDecoder, DeserializerAdapter, SerializerAdapter},
    policy::{DataRepresentation, XCDR_DATA_REPRESENTATION, XCDR2_DATA_REPRESENTATION},
};

use crate::error::Error;

/// Raw CDR of one encoding; `ID` is the second byte of its representation identifier (the first is 0).
pub(super) struct Raw<const ID: u8>;

/// Raw CDR of any encoding that we read.
pub(super) struct AnyRaw;

/// A message that is written.
#[derive(Clone, Debug)]
pub(super) struct Payload {
    /// The bytes of options in its header.
    pub(super) options: [u8; 2],
    /// Its CDR.
    pub(super) body: Bytes,
}

/// All encodings, by the second byte of the identifier.
const READ: [RepresentationIdentifier; 10] = [
    RepresentationIdentifier::CDR_LE,
    RepresentationIdentifier::CDR_BE,
    RepresentationIdentifier::PL_CDR_LE,
    RepresentationIdentifier::PL_CDR_BE,
    RepresentationIdentifier::XCDR2_BE,
    RepresentationIdentifier::XCDR2_LE,
    RepresentationIdentifier::D_CDR2_BE,
    RepresentationIdentifier::D_CDR2_LE,
    RepresentationIdentifier::PL_XCDR2_BE,
    RepresentationIdentifier::PL_XCDR2_LE,
];

/// A reader takes both versions of CDR.
pub(crate) fn accepted() -> DataRepresentation {
    DataRepresentation { value: vec![XCDR_DATA_REPRESENTATION, XCDR2_DATA_REPRESENTATION] }
}

/// The version of CDR of an encoding, as its writer offers it. None for the first one, which is the default.
pub(super) fn offered(id: [u8; 2]) -> Option<DataRepresentation> {
    let is_first = matches!(id, [0, 0..=3]);
    (!is_first).then(|| DataRepresentation { value: vec![XCDR2_DATA_REPRESENTATION] })
}

impl<const ID: u8> SerializerAdapter<Payload> for Raw<ID> {
    type Error = Infallible;

    fn output_encoding() -> RepresentationIdentifier {
        READ.into_iter().find(|known| known.to_bytes() == [0, ID]).unwrap_or(RepresentationIdentifier::CDR_LE)
    }

    fn to_bytes(payload: &Payload) -> Result<Bytes, Infallible> {
        Ok(payload.body.clone())
    }

    fn output_options(payload: &Payload) -> [u8; 2] {
        payload.options
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
        self.decode_payload(body, encoding, [0, 0])
    }

    fn decode_payload(
        self,
        body: &[u8],
        encoding: RepresentationIdentifier,
        options: [u8; 2],
    ) -> Result<Sample, Error> {
        Sample::with_options(encoding.to_bytes(), options, body).map_err(Error::sample)
    }
}
