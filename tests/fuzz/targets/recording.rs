//! A recording of any kind: surveyed, planned and converted.
#![no_main]

use std::{io::Cursor, sync::Arc};

use tidemap_recordings::{
    convert::{CellSize, ConvertOptions, Converter},
    kind::read,
    plan::{Wishes, plan},
    recording::{FileKind, RecordedMessage, Sink, Stopped, Topic},
    survey::Survey,
};

struct Converting(Converter);

impl Sink for Converting {
    fn topic(&mut self, topic: &Topic) -> bool {
        self.0.topic(topic)
    }

    fn message(&mut self, message: RecordedMessage<'_>, _position: u64) -> Result<(), Stopped> {
        self.0.convert(message.topic, message.recorded_nanos, message.data);
        Ok(())
    }
}

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let Ok(kind) = FileKind::detect(bytes) else { return };
    let mut survey = Survey::default();
    // A recording that breaks off gives what came before.
    let _ = read(kind, Cursor::new(bytes), &mut survey);
    let surveyed = survey.finish();
    let Ok(plan) = plan(&surveyed, &Wishes::default()) else { return };
    let cells = CellSize { resolution_m: 0.1, origin_m: [0.0; 3] };
    let converter = Converter::new(Arc::new(surveyed), Arc::new(plan), ConvertOptions { merge: Some(cells), ..ConvertOptions::default() });
    let _ = read(kind, Cursor::new(bytes), &mut Converting(converter));
});
