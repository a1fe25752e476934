//! What is known about a test beside its events.

use serde::{Deserialize, Serialize};

use crate::emission::error::{EmissionError, positive};

/// What was held constant between tests at different temperatures.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum StressProtocol {
    /// The resolved shear stress on the basal planes.
    ResolvedShearStress,
    /// The macroscopic strain rate.
    StrainRate,
    /// The mean velocity of a single dislocation.
    SingleDislocationVelocity,
}

/// Loading or unloading.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum Phase {
    /// Stress applied.
    Loading,
    /// Stress taken away: dislocations move backwards.
    Unloading,
}

/// A sensor.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Sensor {
    /// Number of its channel.
    pub channel: u32,
    /// Position, m.
    #[cfg_attr(feature = "schema", schema(min_items = 3, max_items = 3))]
    pub position_m: [f64; 3],
    /// Sensitivity, V/Pa at the sensor.
    #[serde(default)]
    #[cfg_attr(feature = "schema", schema(exclusive_minimum = 0))]
    pub sensitivity_v_per_pa: Option<f64>,
    /// Delay by which its arrival times are late, s.
    #[serde(default)]
    pub delay_s: f64,
}

/// Nothing is colder, degC.
const ABSOLUTE_ZERO_C: f64 = -273.15;

/// What is known about a test; what is missing is not known.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(default, deny_unknown_fields)]
pub struct Metadata {
    /// Material.
    pub material: Option<String>,
    /// Temperature, degC.
    #[cfg_attr(feature = "schema", schema(minimum = -273.15))]
    pub temperature_c: Option<f64>,
    /// Mean grain size, mm; none for a single crystal.
    #[cfg_attr(feature = "schema", schema(exclusive_minimum = 0))]
    pub grain_size_mm: Option<f64>,
    /// Applied stress, MPa.
    pub stress_mpa: Option<f64>,
    /// Resolved shear stress on the basal planes, kPa.
    pub resolved_shear_stress_kpa: Option<f64>,
    /// Strain rate, 1/s.
    pub strain_rate_per_s: Option<f64>,
    /// What was held constant.
    pub stress_protocol: Option<StressProtocol>,
    /// Loading or unloading, where all events are of one phase.
    pub phase: Option<Phase>,
    /// Gain of the preamplifier, dB: amplitude_v is behind it, amplitude_db before it.
    pub preamp_gain_db: Option<f64>,
    /// Detection threshold behind the preamplifier, V.
    #[cfg_attr(feature = "schema", schema(exclusive_minimum = 0))]
    pub threshold_v: Option<f64>,
    /// Standard error of a coordinate of a located event, m.
    #[cfg_attr(feature = "schema", schema(exclusive_minimum = 0))]
    pub location_error_m: Option<f64>,
    /// Speed of longitudinal waves, m/s.
    #[cfg_attr(feature = "schema", schema(exclusive_minimum = 0))]
    pub longitudinal_speed_m_per_s: Option<f64>,
    /// Speed of transverse waves, m/s.
    #[cfg_attr(feature = "schema", schema(exclusive_minimum = 0))]
    pub transverse_speed_m_per_s: Option<f64>,
    /// Sensors.
    pub sensors: Vec<Sensor>,
}

impl Metadata {
    /// Whether every number can be what it says.
    ///
    /// # Errors
    /// [`EmissionError::Option`] under the name of the field.
    pub fn check(&self) -> Result<(), EmissionError> {
        for (name, value) in [
            ("grain_size_mm", self.grain_size_mm),
            ("threshold_v", self.threshold_v),
            ("location_error_m", self.location_error_m),
            ("longitudinal_speed_m_per_s", self.longitudinal_speed_m_per_s),
            ("transverse_speed_m_per_s", self.transverse_speed_m_per_s),
        ] {
            value.map(|value| positive(name, value)).transpose()?;
        }
        for (name, value) in [
            ("temperature_c", self.temperature_c),
            ("stress_mpa", self.stress_mpa),
            ("resolved_shear_stress_kpa", self.resolved_shear_stress_kpa),
            ("strain_rate_per_s", self.strain_rate_per_s),
            ("preamp_gain_db", self.preamp_gain_db),
        ] {
            if let Some(value) = value.filter(|value| !value.is_finite()) {
                return Err(EmissionError::option(name, value, "a finite number"));
            }
        }
        if let Some(value) = self.temperature_c.filter(|&value| value < ABSOLUTE_ZERO_C) {
            return Err(EmissionError::option("temperature_c", value, format!("at least {ABSOLUTE_ZERO_C} degC")));
        }
        for sensor in &self.sensors {
            if !(sensor.position_m.iter().all(|c| c.is_finite()) && sensor.delay_s.is_finite()) {
                return Err(EmissionError::option("sensors", format!("channel {}", sensor.channel), "finite numbers"));
            }
            sensor.sensitivity_v_per_pa.map(|value| positive("sensitivity_v_per_pa", value)).transpose()?;
        }
        Ok(())
    }
}
