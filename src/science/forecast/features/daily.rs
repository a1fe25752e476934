//! Quantities of one day, made from the variables recorded on that day alone. Missing is NaN.
//!
//! A quantity is known as soon as what is known decides it: no drift means no wind transport whatever the wind.

use crate::forecast::day::{DayRecord, Variable};

/// What stands for the new snow of a day, in the order of preference of [`Snow::of`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Snow {
    /// `new_snow_index`, 0 to 10.
    Index,
    /// `new_snow_24h`, cm.
    Depth,
    /// `precipitation_24h` (mm) on days with air temperature at or below 0 degC, else 0.
    Precipitation,
}

impl Snow {
    /// The best measure of new snow among the `reported` variables.
    pub(super) fn of(reported: &[Variable]) -> Option<Self> {
        let has = |v| reported.contains(&v);
        if has(Variable::NewSnowIndex) {
            Some(Self::Index)
        } else if has(Variable::NewSnow24h) {
            Some(Self::Depth)
        } else {
            (has(Variable::Precipitation24h) && has(Variable::AirTemperature)).then_some(Self::Precipitation)
        }
    }

    fn at(self, day: &DayRecord) -> f64 {
        match self {
            Self::Index => value(day, Variable::NewSnowIndex),
            Self::Depth => value(day, Variable::NewSnow24h),
            Self::Precipitation => {
                let (water, air) = (value(day, Variable::Precipitation24h), value(day, Variable::AirTemperature));
                if air > 0.0 || water <= 0.0 {
                    0.0
                } else if air.is_nan() {
                    f64::NAN
                } else {
                    water
                }
            }
        }
    }

    const fn inputs(self) -> &'static [Variable] {
        match self {
            Self::Index => &[Variable::NewSnowIndex],
            Self::Depth => &[Variable::NewSnow24h],
            Self::Precipitation => &[Variable::Precipitation24h, Variable::AirTemperature],
        }
    }
}

/// What tells that rain fell on the snow of a day, in the order of preference of [`Rain::of`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Rain {
    /// `rain_at_900m` and air temperature above 0 degC.
    At900m,
    /// `rain_at_900m` of a station without air temperature.
    At900mAlone,
    /// `precipitation_24h` above 0 and air temperature above 0 degC.
    Precipitation,
}

impl Rain {
    /// The best sign of rain among the `reported` variables.
    pub(super) fn of(reported: &[Variable]) -> Option<Self> {
        let has = |v| reported.contains(&v);
        match (has(Variable::RainAt900m), has(Variable::AirTemperature)) {
            (true, true) => Some(Self::At900m),
            (true, false) => Some(Self::At900mAlone),
            (false, true) => has(Variable::Precipitation24h).then_some(Self::Precipitation),
            (false, false) => None,
        }
    }

    fn at(self, day: &DayRecord) -> f64 {
        let wet = match self {
            Self::At900m | Self::At900mAlone => above(value(day, Variable::RainAt900m), 0.0),
            Self::Precipitation => above(value(day, Variable::Precipitation24h), 0.0),
        };
        if self == Self::At900mAlone {
            return wet;
        }
        let warm = above(value(day, Variable::AirTemperature), 0.0);
        if wet == 0.0 || warm == 0.0 { 0.0 } else { wet * warm }
    }

    const fn inputs(self) -> &'static [Variable] {
        match self {
            Self::At900m => &[Variable::RainAt900m, Variable::AirTemperature],
            Self::At900mAlone => &[Variable::RainAt900m],
            Self::Precipitation => &[Variable::Precipitation24h, Variable::AirTemperature],
        }
    }
}

/// A range of wind directions, degrees clockwise from north.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Sector {
    /// 315 to 45, without 45.
    North,
    /// 45 to 135, without 135.
    East,
    /// 135 to 225, without 225.
    South,
    /// 225 to 315, without 315.
    West,
    /// 135 to 180, both included.
    SouthToSoutheast,
}

impl Sector {
    pub(super) const ALL: [Self; 5] = [Self::North, Self::East, Self::South, Self::West, Self::SouthToSoutheast];

    fn contains(self, direction: f64) -> bool {
        let d = direction.rem_euclid(360.0);
        match self {
            Self::North => !(45.0..315.0).contains(&d),
            Self::East => (45.0..135.0).contains(&d),
            Self::South => (135.0..225.0).contains(&d),
            Self::West => (225.0..315.0).contains(&d),
            Self::SouthToSoutheast => (135.0..=180.0).contains(&d),
        }
    }

    const fn stem(self) -> &'static str {
        match self {
            Self::North => "wind_sector_north",
            Self::East => "wind_sector_east",
            Self::South => "wind_sector_south",
            Self::West => "wind_sector_west",
            Self::SouthToSoutheast => "wind_sector_south_to_southeast",
        }
    }

    const fn bounds(self) -> &'static str {
        match self {
            Self::North => "in [315, 360) or [0, 45)",
            Self::East => "in [45, 135)",
            Self::South => "in [135, 225)",
            Self::West => "in [225, 315)",
            Self::SouthToSoutheast => "in [135, 180]",
        }
    }
}

/// A quantity of one day.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Daily {
    /// A variable as recorded.
    Value(Variable),
    /// New snow.
    NewSnow(Snow),
    /// 1 where there was new snow, else 0.
    SnowFell(Snow),
    /// 1 where rain fell on the snow, else 0.
    RainOnSnow(Rain),
    /// Air temperature above 0 degC, as degree-days of that day.
    DegreeDays,
    /// Snow temperature minus air temperature, degC.
    SnowMinusAir,
    /// Cube of the wind speed on days with drifting snow, else 0, m3/s3.
    Transport,
    /// Cube of the wind speed, at a station that does not report drift, m3/s3.
    PotentialTransport,
    /// Eastward component of the wind, m/s.
    WindU,
    /// Northward component of the wind, m/s.
    WindV,
    /// 1 where the wind came from the sector, else 0.
    From(Sector),
    /// 1 where more than 80 % of the sky was covered, else 0.
    HighCloud,
}

impl Daily {
    /// The quantity on `day`, in [`Daily::unit`]; NaN where missing.
    pub(super) fn at(self, day: &DayRecord) -> f64 {
        match self {
            Self::Value(variable) => value(day, variable),
            Self::NewSnow(snow) => snow.at(day),
            Self::SnowFell(snow) => above(snow.at(day), 0.0),
            Self::RainOnSnow(rain) => rain.at(day),
            Self::DegreeDays => {
                let air = value(day, Variable::AirTemperature);
                if air < 0.0 { 0.0 } else { air }
            }
            Self::SnowMinusAir => value(day, Variable::SnowTemperature) - value(day, Variable::AirTemperature),
            Self::Transport => {
                let (speed, drift) = (value(day, Variable::WindSpeed), value(day, Variable::SnowDrift));
                if speed == 0.0 || drift == 0.0 { 0.0 } else { cube(speed) * drift }
            }
            Self::PotentialTransport => cube(value(day, Variable::WindSpeed)),
            Self::WindU => wind_component(day, f64::sin),
            Self::WindV => wind_component(day, f64::cos),
            Self::From(sector) => indicator(value(day, Variable::WindDirection), |d| sector.contains(d)),
            Self::HighCloud => above(value(day, Variable::CloudCover), 80.0),
        }
    }

    /// What a feature of this quantity is called before the suffix that names its days.
    pub(super) const fn stem(self) -> &'static str {
        match self {
            Self::Value(variable) => variable.name(),
            Self::NewSnow(Snow::Index) => Variable::NewSnowIndex.name(),
            Self::NewSnow(Snow::Depth) => Variable::NewSnow24h.name(),
            Self::NewSnow(Snow::Precipitation) => "snowfall",
            Self::SnowFell(_) => "snow_indicator",
            Self::RainOnSnow(_) => "rain_on_snow",
            Self::DegreeDays => "degree_days",
            Self::SnowMinusAir => "snow_temperature_gradient",
            Self::Transport | Self::PotentialTransport => "wind_transport",
            Self::WindU => "wind_u",
            Self::WindV => "wind_v",
            Self::From(sector) => sector.stem(),
            Self::HighCloud => "high_cloud",
        }
    }

    /// Unit of the quantity and of its sums, means and changes.
    pub(super) const fn unit(self) -> &'static str {
        match self {
            Self::Value(variable) => variable.unit(),
            Self::NewSnow(Snow::Index) => "1",
            Self::NewSnow(Snow::Depth) => "cm",
            Self::NewSnow(Snow::Precipitation) => "mm",
            Self::SnowFell(_) | Self::From(_) | Self::HighCloud => "bool",
            Self::RainOnSnow(_) => "d",
            Self::DegreeDays => "degC d",
            Self::SnowMinusAir => "degC",
            Self::Transport | Self::PotentialTransport => "m3/s3",
            Self::WindU | Self::WindV => "m/s",
        }
    }

    /// The variables that the quantity is made of.
    pub(super) fn inputs(self) -> Vec<Variable> {
        match self {
            Self::Value(variable) => vec![variable],
            Self::NewSnow(snow) | Self::SnowFell(snow) => snow.inputs().to_vec(),
            Self::RainOnSnow(rain) => rain.inputs().to_vec(),
            Self::DegreeDays => vec![Variable::AirTemperature],
            Self::SnowMinusAir => vec![Variable::SnowTemperature, Variable::AirTemperature],
            Self::Transport => vec![Variable::WindSpeed, Variable::SnowDrift],
            Self::PotentialTransport => vec![Variable::WindSpeed],
            Self::WindU | Self::WindV => vec![Variable::WindSpeed, Variable::WindDirection],
            Self::From(_) => vec![Variable::WindDirection],
            Self::HighCloud => vec![Variable::CloudCover],
        }
    }

    /// The quantity written out for the day called `day` (`t`, `t-1`, `t-k`); `[...]` is 1 where it holds, else 0.
    pub(super) fn formula(self, day: &str) -> String {
        match self {
            Self::Value(_) | Self::NewSnow(Snow::Index | Snow::Depth) => format!("{}({day})", self.stem()),
            Self::NewSnow(Snow::Precipitation) => {
                format!("precipitation_24h({day}) [air_temperature({day}) <= 0]")
            }
            Self::SnowFell(snow) => format!("[{} > 0]", Self::NewSnow(snow).formula(day)),
            Self::RainOnSnow(Rain::At900m) => format!("[rain_at_900m({day}) > 0 and air_temperature({day}) > 0]"),
            Self::RainOnSnow(Rain::At900mAlone) => format!("[rain_at_900m({day}) > 0]"),
            Self::RainOnSnow(Rain::Precipitation) => {
                format!("[precipitation_24h({day}) > 0 and air_temperature({day}) > 0]")
            }
            Self::DegreeDays => format!("max(air_temperature({day}), 0)"),
            Self::SnowMinusAir => format!("(snow_temperature({day}) - air_temperature({day}))"),
            Self::Transport => format!("wind_speed({day})^3 snow_drift({day})"),
            Self::PotentialTransport => format!("wind_speed({day})^3"),
            Self::WindU => format!("-wind_speed({day}) sin(wind_direction({day}))"),
            Self::WindV => format!("-wind_speed({day}) cos(wind_direction({day}))"),
            Self::From(sector) => format!("[wind_direction({day}) {}]", sector.bounds()),
            Self::HighCloud => format!("[cloud_cover({day}) > 80]"),
        }
    }
}

/// A recorded value; what is not finite is as good as missing.
fn value(day: &DayRecord, variable: Variable) -> f64 {
    day.value(variable).filter(|x| x.is_finite()).unwrap_or(f64::NAN)
}

fn indicator(x: f64, holds: impl Fn(f64) -> bool) -> f64 {
    if x.is_nan() {
        f64::NAN
    } else if holds(x) {
        1.0
    } else {
        0.0
    }
}

fn above(x: f64, bound: f64) -> f64 {
    indicator(x, |x| x > bound)
}

fn cube(x: f64) -> f64 {
    x * x * x
}

/// The wind blows towards the opposite of the direction it comes from; calm air has no direction and both components 0.
fn wind_component(day: &DayRecord, projection: impl Fn(f64) -> f64) -> f64 {
    let speed = value(day, Variable::WindSpeed);
    if speed == 0.0 {
        return 0.0;
    }
    -speed * projection(value(day, Variable::WindDirection).to_radians())
}
