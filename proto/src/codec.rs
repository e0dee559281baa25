//! The codec of all services: prost's, with the bounds of requests checked before they are decoded.
//!
//! Invariant: what is encoded is what prost encodes.

use std::marker::PhantomData;

use prost::{Message, Name, bytes::Buf as _};
use tonic::{
    Status,
    codec::{Codec, DecodeBuf, Decoder},
};
use tonic_prost::{ProstDecoder, ProstEncoder};

use crate::bounds;

/// Encodes `T` and decodes `U`.
#[derive(Debug)]
pub struct BoundedCodec<T, U>(PhantomData<(T, U)>);

impl<T, U> Default for BoundedCodec<T, U> {
    fn default() -> Self {
        Self(PhantomData)
    }
}

impl<T, U> Codec for BoundedCodec<T, U>
where
    T: Message + Send + 'static,
    U: Message + Default + Name + Send + 'static,
{
    type Encode = T;
    type Decode = U;
    type Encoder = ProstEncoder<T>;
    type Decoder = BoundedDecoder<U>;

    fn encoder(&mut self) -> Self::Encoder {
        ProstEncoder::default()
    }

    fn decoder(&mut self) -> Self::Decoder {
        BoundedDecoder(ProstDecoder::default())
    }
}

/// Decodes messages that keep the bounds.
#[derive(Debug)]
pub struct BoundedDecoder<U>(ProstDecoder<U>);

impl<U: Message + Default + Name> Decoder for BoundedDecoder<U> {
    type Item = U;
    type Error = Status;

    fn decode(&mut self, buffer: &mut DecodeBuf<'_>) -> Result<Option<U>, Status> {
        // A message arrives in one piece.
        if buffer.chunk().len() == buffer.remaining() {
            bounds::check(&U::full_name(), buffer.chunk())
                .map_err(|error| Status::resource_exhausted(error.to_string()))?;
            return self.0.decode(buffer);
        }
        let whole = buffer.copy_to_bytes(buffer.remaining());
        bounds::check(&U::full_name(), &whole).map_err(|error| Status::resource_exhausted(error.to_string()))?;
        let message = U::decode(whole).map_err(|error| Status::internal(error.to_string()))?;
        Ok(Some(message))
    }
}
