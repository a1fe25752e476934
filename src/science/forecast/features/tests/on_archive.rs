//! Features on the Lochaber archive, against counts of its description and a script that shares no code with this one.

use jiff::civil::Date;

use crate::forecast::day::{Label, Variable, season_of};
use crate::forecast::features::archive::{REPORTED, lochaber};
use crate::forecast::features::{FeatureSet, FeatureSetId, History};

/// Feature, missing rows, sum and sum of squares of the known rows over all 1,582 days, by a separate implementation
/// in Python (dictionary of dates, NumPy 2.4.6) that was written from the formulas.
const BY_SCRIPT: [(&str, usize, f64, f64); 25] = [
    ("air_temperature_t2", 31, -2_446.19, 21_140.318_1),
    ("new_snow_index_season_sum", 1, 223_086.0, 47_275_284.0),
    ("new_snow_index_sum3", 31, 11_170.0, 151_604.0),
    ("new_snow_index_sum5", 61, 18_336.0, 366_536.0),
    ("new_snow_index_decayed5", 61, 7_096.25, 62_104.625),
    ("foot_penetration_change2", 31, 83.0, 261_707.0),
    ("snow_temperature_change1", 19, -8.4, 3_779.72),
    ("air_temperature_mean3", 31, -2_412.656_666_666_666_8, 15_510.966_477_777_778),
    ("air_temperature_max3", 31, 507.51, 15_579.628_1),
    ("air_temperature_crossing", 16, 377.0, 377.0),
    ("degree_days_sum3", 31, 3_281.1, 25_454.23),
    ("snow_temperature_gradient_change1", 19, -37.4, 12_619.336_2),
    ("wind_transport_sum3", 31, 7_805_706.379_821_263, 145_678_990_125.878_3),
    ("wind_u_t", 2, 7_249.376_723_090_25, 138_472.696_684_016_6),
    ("wind_v_t", 2, 6_462.554_445_178_534, 135_393.965_078_338_57),
    ("wind_sector_north_t", 1, 265.0, 265.0),
    ("wind_sector_south_to_southeast_t", 1, 200.0, 200.0),
    ("rain_on_snow_sum3", 31, 690.0, 1_082.0),
    ("high_cloud_t", 2, 1_087.0, 1_087.0),
    ("days_since_snow", 28, 2_905.0, 16_851.0),
    ("activity_t1", 20, 455.5, 374.75),
    ("activity_t2", 34, 453.0, 373.0),
    ("activity_sum5", 92, 2_223.0, 6_068.0),
    ("day_of_season_sine", 0, -898.975_082_011_918_5, 753.213_702_973_895_1),
    ("day_of_season_cosine", 0, -977.767_549_770_589, 828.786_297_026_104_9),
];

#[test]
fn columns_agree_with_a_separate_implementation() {
    let Some(days) = lochaber() else { return };
    let history = History::new(&days).unwrap();
    let expert = FeatureSet::new(FeatureSetId::Expert, &REPORTED);
    let bases: Vec<Date> = days.iter().map(|day| day.date).collect();
    let matrix = expert.matrix(&history, &bases);
    assert_eq!((matrix.rows(), matrix.cols()), (1582, 64));
    for (name, missing, sum, squares) in BY_SCRIPT {
        let column = matrix.column(expert.names().iter().position(|&n| n == name).unwrap());
        let known: Vec<f64> = column.into_iter().filter(|x| !x.is_nan()).collect();
        assert_eq!(1582 - known.len(), missing, "missing {name}");
        let close = |x: f64, expected: f64| (x - expected).abs() <= 1e-9 * expected.abs().max(1.0);
        assert!(close(known.iter().sum(), sum), "sum of {name}");
        assert!(close(known.iter().map(|x| x * x).sum(), squares), "squares of {name}");
    }
    for (i, &base) in bases.iter().enumerate().step_by(97) {
        let bits = |row: &[f64]| row.iter().map(|x| x.to_bits()).collect::<Vec<_>>();
        assert_eq!(bits(matrix.row(i)), bits(&expert.compute(&history, base)));
    }
}

#[test]
fn the_exported_cumulative_index_rises_by_the_snow_index_but_on_37_pairs_of_days() {
    let Some(days) = lochaber() else { return };
    let history = History::new(&days).unwrap();
    let expert = FeatureSet::new(FeatureSetId::Expert, &REPORTED);
    let column = expert.names().iter().position(|&n| n == "new_snow_index_season_sum").unwrap();
    let ours: Vec<f64> = days.iter().map(|day| expert.compute(&history, day.date)[column]).collect();
    let exported = |i: usize| days[i].value(Variable::CumulativeSnowIndex);
    let (mut compared, mut different) = (0, 0);
    for i in (1..days.len()).filter(|&i| season_of(days[i].date) == season_of(days[i - 1].date)) {
        let (Some(before), Some(after)) = (exported(i - 1), exported(i)) else { continue };
        compared += 1;
        different += usize::from(after - before != ours[i] - ours[i - 1]);
    }
    assert_eq!((compared, different), (1567, 37));
}

#[test]
fn labelled_days_with_both_days_before_number_1542() {
    let Some(days) = lochaber() else { return };
    let history = History::new(&days).unwrap();
    let present = |date: Date| history.day(date).is_some();
    let with_lags: Vec<_> = days
        .iter()
        .filter(|day| {
            let yesterday = day.date.yesterday().unwrap();
            present(yesterday) && present(yesterday.yesterday().unwrap())
        })
        .filter_map(|day| Label::Observed.of(day.activity))
        .collect();
    assert_eq!(with_lags.len(), 1542);
    let all: Vec<_> = days.iter().filter_map(|day| Label::Observed.of(day.activity)).collect();
    assert_eq!((all.len(), all.iter().filter(|&&avalanche| avalanche).count()), (1572, 294));
    assert_eq!(days.iter().filter(|day| Label::Presumed.of(day.activity) == Some(true)).count(), 619);
}
