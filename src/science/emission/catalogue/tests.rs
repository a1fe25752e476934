use super::*;
use crate::emission::close;

fn catalogue(columns: &[(Column, Vec<f64>)]) -> Result<Catalogue, EmissionError> {
    Catalogue::new(columns.iter().cloned().collect(), Metadata::default())
}

#[test]
fn what_cannot_be_is_named_with_its_row() {
    for (columns, words) in [
        (vec![(Column::AmplitudeV, vec![1.0, 0.0])], "amplitude_v, row 2: 0 is refused"),
        (vec![(Column::AmplitudeDb, vec![1.0, 0.0, f64::NAN])], "amplitude_db, row 3: NaN"),
        (vec![(Column::TimeS, vec![1.0, 0.5])], "time_s, row 2: 0.5 is refused, a time not before"),
        (vec![(Column::TimeS, vec![1.0]), (Column::Counts, vec![])], "column counts has 0 rows, 1 are expected"),
        (vec![(Column::Phase, vec![2.0])], "phase, row 1"),
    ] {
        let error = catalogue(&columns).unwrap_err().to_string();
        assert!(error.contains(words), "{error}");
    }
    let metadata = Metadata { grain_size_mm: Some(-1.0), ..Metadata::default() };
    assert!(Catalogue::new(BTreeMap::new(), metadata).unwrap_err().to_string().starts_with("grain_size_mm is -1"));
    let empty = catalogue(&[]).unwrap();
    let missing = empty.require(Column::EnergyEu, "energy_distribution").unwrap_err().to_string();
    assert_eq!(missing, "column energy_eu is missing: energy_distribution needs it");
}

#[test]
fn decibels_become_volts_behind_the_preamplifier() {
    // 30 dB_AE is 31.6 uV at the sensor, 3.16 mV behind 40 dB
    let mut catalogue = catalogue(&[(Column::AmplitudeDb, vec![30.0, 45.5, 60.5])]).unwrap();
    catalogue.metadata.preamp_gain_db = Some(40.0);
    close(catalogue.amplitudes_v("x").unwrap()[0], 10f64.powf(3.5) * 1e-6, 1e-12);
    let Sample::Rounded(levels) = catalogue.amplitude_sample(None, Rounding::Nearest, "x").unwrap() else { panic!() };
    assert_eq!((levels.step_db, levels.levels), (0.5, vec![60, 91, 121]));
}

#[test]
fn steps_of_decibels_are_found() {
    assert_eq!(decibel_step(&[40.0, 41.0, 47.0]), Some(1.0));
    assert_eq!(decibel_step(&[40.1, 41.0, 47.0]), Some(0.1));
    assert_eq!(decibel_step(&[40.123, 41.0, 47.0]), None);
    assert_eq!(decibel_step(&[40.0, 40.0]), None);
}

fn kinds(catalogue: &Catalogue) -> Vec<FlagKind> {
    quality(catalogue).into_iter().map(|flag| flag.kind).collect()
}

#[test]
fn each_flag_is_raised_by_its_fault_alone() {
    let n = 500;
    let clean: Vec<f64> = (0..n).map(|i| 0.003 * f64::from(n) / f64::from(n - i)).collect();
    let times: Vec<f64> = (0..n).map(f64::from).collect();
    let good = vec![(Column::AmplitudeV, clean.clone()), (Column::TimeS, times), (Column::DurationUs, clean.clone())];
    assert_eq!(kinds(&catalogue(&good).unwrap()), []);
    let with = |column: Column, change: &dyn Fn(f64) -> f64| {
        let mut columns = good.clone();
        for (c, values) in &mut columns {
            if *c == column {
                values.iter_mut().for_each(|x| *x = change(*x));
            }
        }
        kinds(&catalogue(&columns).unwrap())
    };
    assert_eq!(with(Column::AmplitudeV, &|x| x.max(0.0031)), [FlagKind::FloorPileUp]);
    assert_eq!(with(Column::AmplitudeV, &|x| x.min(0.1)), [FlagKind::Saturation]);
    assert_eq!(with(Column::DurationUs, &|x| x.min(0.1)), [FlagKind::DurationCap]);
    assert_eq!(with(Column::TimeS, &|x| if x == 7.0 { 6.0 } else { x }), [FlagKind::DuplicateTimes]);
    let decibels = clean.iter().map(|x| (20.0 * (x / 1e-6).log10()).round()).collect();
    assert_eq!(kinds(&catalogue(&[(Column::AmplitudeDb, decibels)]).unwrap()), [FlagKind::DecibelResolution]);
    assert_eq!(kinds(&catalogue(&[(Column::Counts, vec![1.0; 7])]).unwrap()), [FlagKind::TooFewEvents]);
}
