//! Waveforms as files, and the hits that two time constants find in them.
//!
//! WAV (one channel of the recorder a channel of the file), NPY (an array of samples, or one a channel; numpy.org, "NPY
//! format") and the records of Vallen's `.tradb`. A sensitivity scan beside the hits says how far their exponent hangs on the
//! threshold and the time constants.

use std::io::{BufRead, BufReader, Read};

use super::{FileError, FileFormat, ReadOptions, Reading};
use crate::{
    domain::dataset::{Columns, WaveformOrigin},
    science::{
        emission::{
            catalogue::Column,
            hits::{Hit, HitOptions, SensitivityOptions, Waveform, hits, sensitivity},
        },
        progress::Unobserved,
    },
};

/// Most samples of all waveforms of a file: they are held in memory, 8 bytes each.
pub const MOST_SAMPLES: usize = 32 * 1024 * 1024;

/// What is needed to make hits of waveforms.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct WaveOptions {
    /// Threshold of the absolute value, V.
    pub threshold_v: Option<f64>,
    /// Hit definition time T1, s.
    pub hit_definition_s: Option<f64>,
    /// Hit lock-out time T2, s.
    pub hit_lockout_s: Option<f64>,
    /// Peak definition time, s.
    pub peak_definition_s: Option<f64>,
    /// Samples a second, Hz, where the file does not say it.
    pub sample_rate_hz: Option<f64>,
    /// Volts of the largest sample that a WAV file can hold.
    pub full_scale_v: Option<f64>,
}

/// A stretch of waveform.
#[derive(Clone, Debug, PartialEq)]
pub struct Wave {
    /// Number of the channel.
    pub channel: u32,
    /// Samples a second, Hz.
    pub rate_hz: f64,
    /// Time of the first sample, s.
    pub start_s: f64,
    /// Samples, V.
    pub samples: Vec<f64>,
}

fn malformed(format: FileFormat, detail: impl std::fmt::Display) -> FileError {
    FileError::Malformed { format: format.name(), detail: detail.to_string() }
}

fn needed(option: &'static str, value: Option<f64>, why: &'static str) -> Result<f64, FileError> {
    value.ok_or(FileError::Needed { option, why })
}

/// Reads a WAV file.
///
/// # Errors
/// [`FileError`], also where nothing says how many volts the largest sample is.
pub fn read_wav(source: impl Read, options: &WaveOptions) -> Result<Vec<Wave>, FileError> {
    let failed = |error: hound::Error| malformed(FileFormat::Wav, error);
    let full_scale = needed("full_scale_v", options.full_scale_v, "the largest sample of a WAV file has no unit")?;
    let mut reader = hound::WavReader::new(source).map_err(failed)?;
    let spec = reader.spec();
    if spec.sample_rate == 0 || spec.channels == 0 {
        return Err(malformed(FileFormat::Wav, "no channel or no sample rate"));
    }
    if reader.len() as usize > MOST_SAMPLES {
        return Err(FileError::TooManySamples);
    }
    let mut waves: Vec<Wave> = (1..=u32::from(spec.channels))
        .map(|channel| Wave { channel, rate_hz: f64::from(spec.sample_rate), start_s: 0.0, samples: Vec::new() })
        .collect();
    let channels = waves.len();
    let mut place = 0;
    let mut take = |sample: f64| {
        waves[place].samples.push(sample);
        place = (place + 1) % channels;
    };
    match spec.sample_format {
        hound::SampleFormat::Float => {
            for sample in reader.samples::<f32>() {
                take(f64::from(sample.map_err(failed)?) * full_scale);
            }
        }
        hound::SampleFormat::Int => {
            let largest = 2f64.powi(i32::from(spec.bits_per_sample) - 1);
            for sample in reader.samples::<i32>() {
                take(f64::from(sample.map_err(failed)?) / largest * full_scale);
            }
        }
    }
    Ok(waves)
}

/// Reads an NPY file: an array of samples, or of channels with samples each.
///
/// # Errors
/// [`FileError`], also where nothing says what a sample is in volts and how many there are a second.
pub fn read_npy(source: impl Read, options: &ReadOptions) -> Result<Vec<Wave>, FileError> {
    let mut source = BufReader::new(source);
    let unit = options.amplitude_unit.ok_or_else(|| FileError::NoUnit { column: "of samples".into() })?;
    let (Column::AmplitudeV, volts) = unit.column() else {
        let detail = "samples are in v, mv or uv: decibels have no sign";
        return Err(malformed(FileFormat::Npy, detail));
    };
    let rate_hz = needed("sample_rate_hz", options.wave.sample_rate_hz, "an NPY file holds samples alone")?;
    let header = NpyHeader::read(&mut source).map_err(|detail| malformed(FileFormat::Npy, detail))?;
    let (channels, length) = match header.shape[..] {
        [length] => (1, length),
        [channels, length] => (channels, length),
        _ => return Err(malformed(FileFormat::Npy, "samples, or channels of samples, are accepted")),
    };
    if channels.checked_mul(length).is_none_or(|all| all > MOST_SAMPLES) {
        return Err(FileError::TooManySamples);
    }
    let mut bytes = vec![0; length * header.number.size()];
    let mut waves = Vec::with_capacity(channels.min(64));
    for channel in (1_u32..).take(channels) {
        source
            .read_exact(&mut bytes)
            .map_err(|_| malformed(FileFormat::Npy, "the file is shorter than its header says"))?;
        let samples = bytes.chunks_exact(header.number.size()).map(|sample| header.number.value(sample) * volts);
        waves.push(Wave { channel, rate_hz, start_s: 0.0, samples: samples.collect() });
    }
    if source.fill_buf().is_ok_and(|rest| !rest.is_empty()) {
        return Err(malformed(FileFormat::Npy, "the file is longer than its header says"));
    }
    Ok(waves)
}

/// How a number of an NPY file is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum NpyNumber {
    I16,
    I32,
    F32,
    F64,
}

impl NpyNumber {
    const fn size(self) -> usize {
        match self {
            Self::I16 => 2,
            Self::I32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    /// The number in little-endian bytes of its size.
    fn value(self, bytes: &[u8]) -> f64 {
        match (self, bytes) {
            (Self::I16, [a, b]) => f64::from(i16::from_le_bytes([*a, *b])),
            (Self::I32, [a, b, c, d]) => f64::from(i32::from_le_bytes([*a, *b, *c, *d])),
            (Self::F32, [a, b, c, d]) => f64::from(f32::from_le_bytes([*a, *b, *c, *d])),
            (Self::F64, [a, b, c, d, e, f, g, h]) => f64::from_le_bytes([*a, *b, *c, *d, *e, *f, *g, *h]),
            _ => f64::NAN,
        }
    }
}

/// The header of an NPY file.
#[derive(Debug, PartialEq, Eq)]
struct NpyHeader {
    number: NpyNumber,
    shape: Vec<usize>,
}

impl NpyHeader {
    fn read(source: &mut impl Read) -> Result<Self, String> {
        let mut begin = [0; 8];
        let broken = |_| "the header breaks off".to_owned();
        source.read_exact(&mut begin).map_err(broken)?;
        if !begin.starts_with(b"\x93NUMPY") {
            return Err("it does not begin as an NPY file does".into());
        }
        let mut size = [0; 4];
        let wide = begin[6] >= 2;
        source.read_exact(&mut size[..if wide { 4 } else { 2 }]).map_err(broken)?;
        let size = u32::from_le_bytes(size) as usize;
        if size > 64 * 1024 {
            return Err("the header is longer than that of any array of numbers".into());
        }
        let mut text = vec![0; size];
        source.read_exact(&mut text).map_err(broken)?;
        Self::parse(&String::from_utf8_lossy(&text))
    }

    /// Reads `{'descr': '<f4', 'fortran_order': False, 'shape': (2, 3), }`.
    fn parse(text: &str) -> Result<Self, String> {
        let after = |key: &str| {
            let (_, rest) = text.split_once(&format!("'{key}'")).ok_or_else(|| format!("the header has no {key}"))?;
            Ok::<&str, String>(rest.trim_start().strip_prefix(':').unwrap_or(rest).trim_start())
        };
        let descr = after("descr")?.strip_prefix('\'').and_then(|rest| rest.split('\'').next()).unwrap_or_default();
        let number = match descr {
            "<i2" => NpyNumber::I16,
            "<i4" => NpyNumber::I32,
            "<f4" => NpyNumber::F32,
            "<f8" => NpyNumber::F64,
            other => return Err(format!("numbers of the type {other:?}; <i2, <i4, <f4 and <f8 are accepted")),
        };
        let shape = after("shape")?.strip_prefix('(').and_then(|rest| rest.split(')').next()).unwrap_or_default();
        let shape: Vec<usize> = shape
            .split(',')
            .map(str::trim)
            .filter(|side| !side.is_empty())
            .map(|side| side.parse().map_err(|_| format!("a side of {side:?}")))
            .collect::<Result<_, String>>()?;
        if shape.len() > 1 && !after("fortran_order")?.starts_with("False") {
            return Err("an array in the order of Fortran; that of C is accepted".into());
        }
        Ok(Self { number, shape })
    }
}

/// The samples of a record of a `.tradb`: counts of the converter, plain or packed as FLAC.
///
/// # Errors
/// What is wrong with them, in words.
pub fn counts(format: i64, data: &[u8], volts: f64) -> Result<Vec<f64>, String> {
    match format {
        0 => {
            let (counts, rest) = data.as_chunks::<2>();
            if !rest.is_empty() {
                return Err("a record with half a sample".into());
            }
            Ok(counts.iter().map(|count| f64::from(i16::from_le_bytes(*count)) * volts).collect())
        }
        2 => {
            let failed = |error: claxon::Error| format!("a record whose FLAC cannot be read: {error}");
            let mut reader = claxon::FlacReader::new(data).map_err(failed)?;
            let (info, mut samples) = (reader.streaminfo(), Vec::new());
            if info.channels != 1 || info.bits_per_sample != 16 {
                return Err("a record whose FLAC is not of one channel of 16 bits".into());
            }
            for count in reader.samples() {
                samples.push(f64::from(count.map_err(failed)?) * volts);
                if samples.len() > MOST_SAMPLES {
                    return Err("a record that is too long".into());
                }
            }
            Ok(samples)
        }
        other => Err(format!("a record of the data format {other}; 0 (plain) and 2 (FLAC) are accepted")),
    }
}

/// The hits in waveforms, in the order of time.
///
/// # Errors
/// [`FileError`], also where threshold or time constants are missing.
pub fn into_hits(waves: &[Wave], options: &WaveOptions) -> Result<Reading, FileError> {
    const WHY: &str = "waveforms become hits by a threshold and two time constants";
    let settings = HitOptions {
        threshold_v: needed("threshold_v", options.threshold_v, WHY)?,
        hit_definition_s: needed("hit_definition_s", options.hit_definition_s, WHY)?,
        hit_lockout_s: needed("hit_lockout_s", options.hit_lockout_s, WHY)?,
        peak_definition_s: options.peak_definition_s,
    };
    let waveforms: Vec<Waveform<'_>> = waves
        .iter()
        .map(|wave| Waveform { samples: &wave.samples, rate_hz: wave.rate_hz, start_s: wave.start_s })
        .collect();
    let mut found: Vec<(u32, Hit)> = Vec::new();
    for (wave, waveform) in waves.iter().zip(&waveforms) {
        found.extend(hits(waveform, &settings)?.into_iter().map(|hit| (wave.channel, hit)));
    }
    found.sort_by(|a, b| a.1.time_s.total_cmp(&b.1.time_s));
    let cut = found.iter().filter(|(_, hit)| hit.cut).count();
    let around = |value: f64, factors: [f64; 3]| factors.map(|factor| value * factor).to_vec();
    let scan = SensitivityOptions {
        // 0, 3 and 6 dB above
        threshold_v: around(settings.threshold_v, [1.0, 10f64.powf(0.15), 10f64.powf(0.3)]),
        hit_definition_s: around(settings.hit_definition_s, [1.0, 2.0, 4.0]),
        hit_lockout_s: if settings.hit_lockout_s > 0.0 {
            around(settings.hit_lockout_s, [0.5, 1.0, 2.0])
        } else {
            vec![0.0]
        },
        xmin: None,
    };
    let mut notes = vec![format!("{} hits were found in {} waveforms", found.len(), waves.len())];
    if cut > 0 {
        notes.push(format!("{cut} hits may be longer: their waveform ends before the hit definition time has run out"));
    }
    let waveform = WaveformOrigin {
        waveforms: waves.len(),
        samples: waves.iter().map(|wave| wave.samples.len()).sum(),
        settings,
        sensitivity: sensitivity(&waveforms, &scan, &Unobserved)?,
    };
    Ok(Reading { columns: columns(&found), notes, waveform: Some(waveform), ..Reading::default() })
}

fn columns(found: &[(u32, Hit)]) -> Columns {
    let all = |of: &dyn Fn(&Hit) -> f64| found.iter().map(|(_, hit)| of(hit)).collect::<Vec<f64>>();
    Columns::from([
        (Column::TimeS, all(&|hit| hit.time_s)),
        (Column::AmplitudeV, all(&|hit| hit.features.amplitude_v)),
        (Column::DurationUs, all(&|hit| hit.features.duration_us)),
        (Column::RiseTimeUs, all(&|hit| hit.features.rise_time_us)),
        (Column::Counts, all(&|hit| f64::from(hit.features.counts))),
        (Column::EnergyEu, all(&|hit| hit.features.energy_eu)),
        (Column::Channel, found.iter().map(|(channel, _)| f64::from(*channel)).collect()),
    ])
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::formats::emission::AmplitudeUnit;

    const RATE_HZ: f64 = 1e6;

    /// Two bursts of 0.5 V and 0.25 V, 2 ms apart, each 100 samples of a square wave of 100 kHz; zero elsewhere.
    fn samples() -> Vec<f64> {
        let mut samples = vec![0.0; 5000];
        for (begin, amplitude) in [(1000, 0.5), (3000, 0.25)] {
            for at in 0..100 {
                samples[begin + at] = if at % 10 < 5 { amplitude } else { -amplitude };
            }
        }
        samples
    }

    fn options() -> ReadOptions {
        let wave = WaveOptions {
            threshold_v: Some(0.1),
            hit_definition_s: Some(200e-6),
            hit_lockout_s: Some(100e-6),
            sample_rate_hz: Some(RATE_HZ),
            full_scale_v: Some(1.0),
            ..WaveOptions::default()
        };
        ReadOptions { amplitude_unit: Some(AmplitudeUnit::Volt), wave }
    }

    fn npy(descr: &str, shape: &str, data: &[u8]) -> Vec<u8> {
        let mut text = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}");
        while !(10 + text.len() + 1).is_multiple_of(64) {
            text.push(' ');
        }
        text.push('\n');
        [b"\x93NUMPY\x01\x00", &u16::try_from(text.len()).unwrap().to_le_bytes()[..], text.as_bytes(), data].concat()
    }

    fn wav(samples: &[f64]) -> Vec<u8> {
        let spec = hound::WavSpec {
            channels: 1,
            sample_rate: RATE_HZ as u32,
            bits_per_sample: 16,
            sample_format: hound::SampleFormat::Int,
        };
        let mut bytes = std::io::Cursor::new(Vec::new());
        let mut writer = hound::WavWriter::new(&mut bytes, spec).unwrap();
        samples.iter().for_each(|sample| writer.write_sample((sample * 32768.0) as i16).unwrap());
        writer.finalize().unwrap();
        bytes.into_inner()
    }

    #[test]
    fn the_bursts_of_a_wav_and_an_npy_file_become_the_same_hits() {
        let doubles: Vec<u8> = samples().iter().flat_map(|sample| sample.to_le_bytes()).collect();
        let from_npy = read_npy(npy("<f8", "(5000,)", &doubles).as_slice(), &options()).unwrap();
        let from_wav = read_wav(wav(&samples()).as_slice(), &options().wave).unwrap();
        assert_eq!(from_npy, from_wav);
        let reading = into_hits(&from_npy, &options().wave).unwrap();
        assert_eq!(reading.columns[&Column::TimeS], [1e-3, 3e-3]);
        assert_eq!(reading.columns[&Column::AmplitudeV], [0.5, 0.25]);
        // from the first to the last of 100 samples
        for duration in &reading.columns[&Column::DurationUs] {
            assert!((duration - 99.0).abs() < 1e-9);
        }
        assert_eq!(reading.columns[&Column::Counts], [10.0, 10.0]);
        let origin = reading.waveform.unwrap();
        assert_eq!((origin.waveforms, origin.samples, origin.sensitivity.len()), (1, 5000, 27));
        // above 0.25 V / 1.41 one of them remains at no threshold of the scan but the highest
        assert!(origin.sensitivity.iter().all(|point| point.hits == 2));
    }

    #[test]
    fn several_channels_and_whole_numbers_are_read() {
        let counts: Vec<u8> = [1_i16, -2, 3, 4, 5, 6].iter().flat_map(|count| count.to_le_bytes()).collect();
        let waves = read_npy(npy("<i2", "(2, 3)", &counts).as_slice(), &options()).unwrap();
        assert_eq!(waves.len(), 2);
        assert_eq!((waves[1].channel, waves[1].samples.clone()), (2, vec![4.0, 5.0, 6.0]));
        assert_eq!(super::counts(0, &counts, 0.5).unwrap(), [0.5, -1.0, 1.5, 2.0, 2.5, 3.0]);
        assert!(super::counts(0, &counts[1..], 0.5).is_err() && super::counts(7, &counts, 0.5).is_err());
        assert!(super::counts(2, &counts, 0.5).unwrap_err().contains("FLAC"));
    }

    #[test]
    fn what_is_missing_is_asked_for() {
        let doubles = vec![0; 80];
        let file = npy("<f8", "(10,)", &doubles);
        let of = |options: ReadOptions| {
            read_npy(file.as_slice(), &options).and_then(|waves| into_hits(&waves, &options.wave))
        };
        let without = |change: fn(&mut ReadOptions)| {
            let mut options = options();
            change(&mut options);
            of(options).unwrap_err().to_string()
        };
        assert!(without(|options| options.amplitude_unit = None).contains("amplitude_unit"));
        assert!(without(|options| options.wave.sample_rate_hz = None).contains("sample_rate_hz"));
        assert!(without(|options| options.wave.threshold_v = None).contains("threshold_v"));
        assert!(without(|options| options.wave.hit_lockout_s = None).contains("hit_lockout_s"));
        let mute = WaveOptions { full_scale_v: None, ..options().wave };
        assert!(read_wav(wav(&[0.0]).as_slice(), &mute).unwrap_err().to_string().contains("full_scale_v"));
    }

    #[test]
    fn files_that_were_cut_are_refused() {
        let file = npy("<f8", "(10,)", &[0; 80]);
        for cut in 0..file.len() {
            assert!(read_npy(&file[..cut], &options()).is_err(), "{cut}");
        }
        let file = wav(&samples());
        for cut in [0, 10, 43, 44, 1001] {
            assert!(read_wav(&file[..cut], &options().wave).is_err(), "{cut}");
        }
        for header in ["(10, 2, 2)", "(99999999999,)", "(1e3,)"] {
            assert!(read_npy(npy("<f8", header, &[0; 80]).as_slice(), &options()).is_err(), "{header}");
        }
        assert!(
            read_npy(npy(">f8", "(10,)", &[0; 80]).as_slice(), &options()).unwrap_err().to_string().contains("<f8")
        );
    }

    proptest! {
        #[test]
        fn no_bytes_make_them_panic(bytes: Vec<u8>, at: prop::sample::Index) {
            let mut broken = wav(&samples());
            let at = at.index(200);
            broken.splice(at..at + bytes.len().min(8), bytes.iter().copied().take(8));
            let _ = read_wav(broken.as_slice(), &options().wave);
            let _ = read_npy([&b"\x93NUMPY\x01\x00"[..], &bytes].concat().as_slice(), &options());
            let _ = super::counts(2, &bytes, 1.0);
        }
    }
}
