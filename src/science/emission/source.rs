//! From the amplitude of a wave to the moving dislocations behind it.
//!
//! `A = (3 C_T^2 / (4 pi C_L)) (rho b / D^2) dS/dt` (Rouby, Fleischmann & Duvergier 1983; Weiss et al. 2000), with A the amplitude as a
//! pressure (Pa), C_T and C_L the wave speeds, rho the density (only a density closes the units), b the Burgers vector, D the distance
//! and dS/dt the area that dislocations sweep a second. It holds far from the source: D >= 3 L.

use serde::{Deserialize, Serialize};

use super::error::{EmissionError, positive};

/// The medium, the sensor and the distance.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(default, deny_unknown_fields)]
pub struct SourceOptions {
    /// Speed of longitudinal waves C_L, m/s; none takes that of the metadata, else of ice at -16 degC, 3835 (Gammon et al. 1983).
    pub longitudinal_speed_m_per_s: Option<f64>,
    /// Speed of transverse waves C_T, m/s; none takes that of the metadata, else of ice at -16 degC, 1941.
    pub transverse_speed_m_per_s: Option<f64>,
    /// Density, kg/m3.
    pub density_kg_per_m3: f64,
    /// Length of the Burgers vector, m.
    pub burgers_vector_m: f64,
    /// Distance of source and sensor, m; none takes that of each located event to the first sensor.
    pub distance_m: Option<f64>,
    /// Sensitivity behind the preamplifier, V/Pa; none takes that of the first sensor and the gain.
    pub sensitivity_v_per_pa: Option<f64>,
    /// Speed of the dislocations when an avalanche begins, m/s, for the length of the dislocations.
    pub dislocation_speed_m_per_s: Option<f64>,
    /// Damping g of avalanches, 1/s, for the swept area; none fits it to the durations where they are there.
    pub damping_per_s: Option<f64>,
    /// Volume of the sample, m3, for the strain.
    pub volume_m3: Option<f64>,
}

impl Default for SourceOptions {
    fn default() -> Self {
        Self {
            longitudinal_speed_m_per_s: None,
            transverse_speed_m_per_s: None,
            density_kg_per_m3: 917.0,
            burgers_vector_m: 4.52e-10,
            distance_m: None,
            sensitivity_v_per_pa: None,
            dislocation_speed_m_per_s: None,
            damping_per_s: None,
            volume_m3: None,
        }
    }
}

/// Speeds of sound in ice at -16 degC, averaged over directions, m/s: longitudinal, transverse (Gammon et al. 1983, J. Glaciol. 29).
pub const ICE_SPEEDS_M_PER_S: (f64, f64) = (3835.0, 1941.0);

/// The far-field model of one medium.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SourceModel {
    /// `3 C_T^2 / (4 pi C_L)`, m/s.
    pub speed_factor_m_per_s: f64,
    /// `rho b`, kg/m2.
    pub density_burgers_kg_per_m2: f64,
}

impl SourceModel {
    /// The model of a medium (m/s, m/s, kg/m3, m).
    ///
    /// # Errors
    /// A quantity that is not above 0, or a transverse speed that no solid has (above sqrt(3/4) of the longitudinal one: the bulk
    /// modulus would be negative).
    pub fn new(longitudinal: f64, transverse: f64, density: f64, burgers: f64) -> Result<Self, EmissionError> {
        positive("longitudinal_speed_m_per_s", longitudinal)?;
        positive("transverse_speed_m_per_s", transverse)?;
        positive("density_kg_per_m3", density)?;
        positive("burgers_vector_m", burgers)?;
        if transverse * transverse >= 0.75 * longitudinal * longitudinal {
            let accepted =
                format!("less than {:.1} m/s, sqrt(3/4) of the longitudinal speed", 0.75_f64.sqrt() * longitudinal);
            return Err(EmissionError::option("transverse_speed_m_per_s", transverse, accepted));
        }
        Ok(Self {
            speed_factor_m_per_s: 3.0 * transverse * transverse / (4.0 * std::f64::consts::PI * longitudinal),
            density_burgers_kg_per_m2: density * burgers,
        })
    }

    /// Amplitude (Pa) at `distance` (m) of an area swept at `rate` (m2/s).
    #[must_use]
    pub fn amplitude_pa(&self, rate: f64, distance: f64) -> f64 {
        self.speed_factor_m_per_s * self.density_burgers_kg_per_m2 / (distance * distance) * rate
    }

    /// Area swept a second (m2/s) behind an `amplitude` (Pa) at `distance` (m).
    #[must_use]
    pub fn swept_rate_m2_per_s(&self, amplitude: f64, distance: f64) -> f64 {
        amplitude * distance * distance / (self.speed_factor_m_per_s * self.density_burgers_kg_per_m2)
    }

    /// Length of the dislocations that move at `speed` (m/s) behind an `amplitude` (Pa) at `distance` (m): L = (dS/dt)/v, m.
    ///
    /// # Errors
    /// [`EmissionError::NearField`] where the distance is below 3 L, or a quantity that is not above 0.
    pub fn length_m(&self, amplitude: f64, distance: f64, speed: f64) -> Result<f64, EmissionError> {
        positive("amplitude", amplitude)?;
        positive("distance_m", distance)?;
        positive("dislocation_speed_m_per_s", speed)?;
        let length_m = self.swept_rate_m2_per_s(amplitude, distance) / speed;
        if distance < 3.0 * length_m {
            return Err(EmissionError::NearField { distance_m: distance, length_m });
        }
        Ok(length_m)
    }
}

/// Area (m2) that is swept by an avalanche that begins with `rate` (m2/s) and is damped with `damping` (1/s): S = L v0 / g.
#[must_use]
pub fn swept_area_m2(rate: f64, damping: f64) -> f64 {
    rate / damping
}

/// Strain of a `volume` (m3) by an `area` (m2) that is swept by dislocations of the Burgers vector `burgers` (m): b S / V.
#[must_use]
pub fn strain_increment(area: f64, burgers: f64, volume: f64) -> f64 {
    burgers * area / volume
}

/// What the source model says of a catalogue.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct SourceInversion {
    /// `3 C_T^2 / (4 pi C_L)`, m/s.
    pub speed_factor_m_per_s: f64,
    /// Events that were inverted.
    pub events: usize,
    /// Smallest, median and largest amplitude, Pa.
    pub amplitude_pa: [f64; 3],
    /// Smallest, median and largest distance, m.
    pub distance_m: [f64; 3],
    /// Smallest, median and largest area swept a second, m2/s.
    pub swept_rate_m2_per_s: [f64; 3],
    /// Smallest, median and largest length of the moving dislocations, m; missing without their speed.
    pub length_m: Option<[f64; 3]>,
    /// Events that were left out because D < 3 L.
    pub near_field: usize,
    /// Damping in use, 1/s.
    pub damping_per_s: Option<f64>,
    /// Smallest, median and largest swept area, m2; missing without a damping.
    pub swept_area_m2: Option<[f64; 3]>,
    /// Sum of the strain increments; missing without a damping or the volume.
    pub strain: Option<f64>,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::emission::close;

    #[test]
    fn the_check_values_come_out() {
        // the design page; the units close only with rho as a density: m/s x kg/m3 x m / m2 x m2/s = Pa
        let model = SourceModel::new(3900.0, 1900.0, 917.0, 4.52e-10).unwrap();
        close(model.speed_factor_m_per_s, 220.980517, 1e-6);
        close(model.amplitude_pa(1.0, 0.1) / 9.159288867e-3, 1.0, 1e-9);
        close(model.swept_rate_m2_per_s(model.amplitude_pa(3.7, 0.25), 0.25), 3.7, 1e-12);
    }

    #[test]
    fn a_source_too_close_is_refused() {
        let model = SourceModel::new(3835.0, 1941.0, 917.0, 4.52e-10).unwrap();
        let amplitude = model.amplitude_pa(0.1, 0.1);
        // dS/dt = 0.1 m2/s at 4 m/s is L = 0.025 m, at 2 m/s 0.05 m
        close(model.length_m(amplitude, 0.1, 4.0).unwrap(), 0.025, 1e-12);
        let refused = model.length_m(amplitude, 0.1, 2.0).unwrap_err();
        assert!(
            refused.to_string().contains("the distance of 0.1 m is below 3 times the length of the source"),
            "{refused}"
        );
        // S = 0.1 / 5000 m2, strain b S / V
        close(swept_area_m2(0.1, 5000.0), 2e-5, 1e-18);
        close(strain_increment(2e-5, 4.52e-10, 1e-4), 9.04e-11, 1e-24);
        assert!(SourceModel::new(1900.0, 1941.0, 917.0, 4.52e-10).is_err());
        assert!(model.length_m(amplitude, 0.1, 0.0).is_err());
    }
}
