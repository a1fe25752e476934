//! The source model on a whole catalogue.

use super::durations;
use crate::emission::catalogue::Catalogue;
use crate::emission::duration::DurationOptions;
use crate::emission::error::{EmissionError, positive};
use crate::emission::numerics::quantile;
use crate::emission::source::{
    ICE_SPEEDS_M_PER_S, SourceInversion, SourceModel, SourceOptions, strain_increment, swept_area_m2,
};
use crate::progress::Progress;

const KIND: &str = "source_model";

pub(super) fn invert(
    catalogue: &Catalogue,
    options: &SourceOptions,
    progress: &dyn Progress,
) -> Result<SourceInversion, EmissionError> {
    let model = medium(catalogue, options)?;
    let sensitivity = sensitivity(catalogue, options)?;
    let mut amplitude = Vec::new();
    let mut distance = Vec::new();
    let mut rate = Vec::new();
    let mut length = Vec::new();
    let mut near_field = 0;
    let distances = distances(catalogue, options)?;
    for (row, volts) in catalogue.amplitudes_v(KIND)?.into_iter().enumerate() {
        let Some(d) = distances.of(row) else { continue };
        let pascal = volts / sensitivity;
        if let Some(speed) = options.dislocation_speed_m_per_s {
            match model.length_m(pascal, d, speed) {
                Ok(found) => length.push(found),
                Err(EmissionError::NearField { .. }) => {
                    near_field += 1;
                    continue;
                }
                Err(error) => return Err(error),
            }
        }
        amplitude.push(pascal);
        distance.push(d);
        rate.push(model.swept_rate_m2_per_s(pascal, d));
    }
    if rate.is_empty() {
        return Err(EmissionError::TooFewEvents { what: "events in the far field", found: 0, needed: 1 });
    }
    let damping = match options.damping_per_s {
        Some(damping) => Some(positive("damping_per_s", damping)?),
        None => {
            durations(catalogue, &DurationOptions::default(), 0, progress).ok().map(|scaling| scaling.damping_per_s)
        }
    };
    let area: Option<Vec<f64>> = damping.map(|damping| rate.iter().map(|&r| swept_area_m2(r, damping)).collect());
    let volume = options.volume_m3.map(|volume| positive("volume_m3", volume)).transpose()?;
    let strain = area
        .as_ref()
        .zip(volume)
        .map(|(area, volume)| area.iter().map(|&s| strain_increment(s, options.burgers_vector_m, volume)).sum::<f64>());
    Ok(SourceInversion {
        speed_factor_m_per_s: model.speed_factor_m_per_s,
        events: rate.len(),
        amplitude_pa: summary(amplitude),
        distance_m: summary(distance),
        swept_rate_m2_per_s: summary(rate),
        length_m: (!length.is_empty()).then(|| summary(length)),
        near_field,
        damping_per_s: damping,
        swept_area_m2: area.map(summary),
        strain,
    })
}

/// Whether `catalogue` and `options` hold all that is needed.
pub(super) fn check(catalogue: &Catalogue, options: &SourceOptions) -> Result<(), EmissionError> {
    medium(catalogue, options)?;
    sensitivity(catalogue, options)?;
    distances(catalogue, options)?;
    for (name, value) in [
        ("dislocation_speed_m_per_s", options.dislocation_speed_m_per_s),
        ("damping_per_s", options.damping_per_s),
        ("volume_m3", options.volume_m3),
    ] {
        value.map(|value| positive(name, value)).transpose()?;
    }
    Ok(())
}

fn medium(catalogue: &Catalogue, options: &SourceOptions) -> Result<SourceModel, EmissionError> {
    let metadata = &catalogue.metadata;
    let longitudinal = options.longitudinal_speed_m_per_s.or(metadata.longitudinal_speed_m_per_s);
    let transverse = options.transverse_speed_m_per_s.or(metadata.transverse_speed_m_per_s);
    SourceModel::new(
        longitudinal.unwrap_or(ICE_SPEEDS_M_PER_S.0),
        transverse.unwrap_or(ICE_SPEEDS_M_PER_S.1),
        options.density_kg_per_m3,
        options.burgers_vector_m,
    )
}

/// Sensitivity behind the preamplifier, V/Pa.
fn sensitivity(catalogue: &Catalogue, options: &SourceOptions) -> Result<f64, EmissionError> {
    if let Some(sensitivity) = options.sensitivity_v_per_pa {
        return positive("sensitivity_v_per_pa", sensitivity);
    }
    let at_sensor = catalogue.metadata.sensors.first().and_then(|sensor| sensor.sensitivity_v_per_pa);
    let at_sensor =
        at_sensor.ok_or(EmissionError::MissingMetadata { item: "sensitivity_v_per_pa", needed_by: KIND })?;
    Ok(at_sensor * 10f64.powf(catalogue.metadata.preamp_gain_db.unwrap_or(0.0) / 20.0))
}

/// Distances of the sources from the sensor, m.
enum Distances {
    One(f64),
    /// A distance a row; missing where the event was not located.
    Each(Vec<Option<f64>>),
}

impl Distances {
    fn of(&self, row: usize) -> Option<f64> {
        match self {
            Self::One(distance) => Some(*distance),
            Self::Each(distances) => distances.get(row).copied().flatten(),
        }
    }
}

fn distances(catalogue: &Catalogue, options: &SourceOptions) -> Result<Distances, EmissionError> {
    if let Some(distance) = options.distance_m {
        return Ok(Distances::One(positive("distance_m", distance)?));
    }
    let missing = EmissionError::MissingMetadata { item: "distance_m, or sensors and positions", needed_by: KIND };
    let sensor = catalogue.metadata.sensors.first().ok_or_else(|| missing.clone())?;
    let (positions, rows) = catalogue.positions(KIND).map_err(|_| missing)?;
    let mut distances = vec![None; catalogue.len()];
    for (position, row) in positions.iter().zip(rows) {
        let squares: f64 = position.iter().zip(sensor.position_m).map(|(a, b)| (a - b) * (a - b)).sum();
        distances[row] = Some(squares.sqrt()).filter(|&distance| distance > 0.0);
    }
    Ok(Distances::Each(distances))
}

/// Smallest, median and largest.
fn summary(mut values: Vec<f64>) -> [f64; 3] {
    values.sort_by(f64::total_cmp);
    [0.0, 0.5, 1.0].map(|q| quantile(&values, q))
}
