//! Units and signs of the temperatures, which changed by area and winter.

use jiff::civil::{Date, date};

/// The two temperatures of a profile.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Temperature {
    Air,
    Snow,
}

/// How the sign of an exported temperature is meant.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Sign {
    /// As written.
    Signed,
    /// Degrees below zero, whatever the sign.
    BelowZero,
}

/// From exported number to degC.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Unit {
    /// Exported steps in one degree: 1 or 10.
    divisor: i8,
    sign: Sign,
}

impl Unit {
    /// The temperature, degC, of an exported number.
    pub(super) fn degrees(self, exported: f64) -> f64 {
        let degrees = exported / f64::from(self.divisor);
        match self.sign {
            Sign::Signed => degrees,
            Sign::BelowZero => -degrees.abs(),
        }
    }

    pub(super) const fn is_tenths(self) -> bool {
        self.divisor == 10
    }
}

/// One line of the table: the unit that holds in an area on the days `from` to `to`, both included.
struct Regime {
    what: Temperature,
    /// `None` is every area that has no line of its own for the temperature.
    area: Option<&'static str>,
    from: Date,
    to: Date,
    unit: Unit,
}

const fn regime(
    what: Temperature,
    area: Option<&'static str>,
    (from, to): (Date, Date),
    divisor: i8,
    sign: Sign,
) -> Regime {
    Regime { what, area, from, to, unit: Unit { divisor, sign } }
}

const LOCHABER: Option<&str> = Some("Lochaber");

/// The regimes as they were found in the archive; a winter ends on 30 June.
const REGIMES: [Regime; 9] = {
    use Sign::{BelowZero, Signed};
    use Temperature::{Air, Snow};
    let whole_degrees = (Date::MIN, date(2000, 1, 3));
    let tenths_of_2000 = (date(2000, 1, 4), date(2000, 6, 30));
    let later_below_zero = (date(2000, 7, 1), date(2010, 6, 30));
    let below_zero = (Date::MIN, date(2010, 6, 30));
    let signed = (date(2010, 7, 1), Date::MAX);
    [
        regime(Air, LOCHABER, (Date::MIN, Date::MAX), 1, Signed),
        regime(Air, None, (Date::MIN, date(2007, 6, 30)), 10, Signed),
        regime(Air, None, (date(2007, 7, 1), Date::MAX), 1, Signed),
        regime(Snow, LOCHABER, whole_degrees, 1, BelowZero),
        regime(Snow, LOCHABER, tenths_of_2000, 10, BelowZero),
        regime(Snow, LOCHABER, later_below_zero, 1, BelowZero),
        regime(Snow, LOCHABER, signed, 1, Signed),
        regime(Snow, None, below_zero, 10, BelowZero),
        regime(Snow, None, signed, 1, Signed),
    ]
};

/// The unit of a temperature exported by `area` for `day`; where the area is not known, the unit that all areas share
/// on that day, if they do.
pub(super) fn unit_of(what: Temperature, area: Option<&str>, day: Date) -> Option<Unit> {
    let holding = || REGIMES.iter().filter(move |line| line.what == what && line.from <= day && day <= line.to);
    match area {
        Some(area) => {
            let own = holding().find(|line| line.area.is_some_and(|known| known.eq_ignore_ascii_case(area)));
            own.or_else(|| holding().find(|line| line.area.is_none())).map(|line| line.unit)
        }
        None => {
            let unit = holding().next()?.unit;
            holding().all(|line| line.unit == unit).then_some(unit)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn degrees(what: Temperature, area: &str, day: Date, exported: f64) -> f64 {
        unit_of(what, Some(area), day).unwrap().degrees(exported)
    }

    #[test]
    fn lochaber_stores_degrees_but_for_half_a_winter_of_tenths() {
        let snow = |day, exported| degrees(Temperature::Snow, "Lochaber", day, exported);
        assert_eq!(snow(date(1993, 12, 21), 4.8), -4.8);
        assert_eq!(snow(date(2000, 1, 3), 5.0), -5.0);
        assert_eq!(snow(date(2000, 1, 4), 50.0), -5.0);
        assert_eq!(snow(date(2000, 4, 2), 40.0), -4.0);
        assert_eq!(snow(date(2000, 12, 27), -5.0), -5.0);
        assert_eq!(snow(date(2010, 6, 30), 4.0), -4.0);
        assert_eq!(snow(date(2010, 7, 1), -4.0), -4.0);
        assert_eq!(snow(date(2010, 12, 1), 4.0), 4.0);
        assert_eq!(degrees(Temperature::Air, "LOCHABER", date(1994, 1, 1), -3.5), -3.5);
    }

    #[test]
    fn other_areas_store_tenths_of_air_to_2007_and_of_snow_to_2010() {
        let area = "Southern Cairngorms";
        assert_eq!(degrees(Temperature::Air, area, date(2007, 6, 30), -35.0), -3.5);
        assert_eq!(degrees(Temperature::Air, area, date(2007, 7, 1), -3.5), -3.5);
        assert_eq!(degrees(Temperature::Snow, area, date(2010, 6, 30), 35.0), -3.5);
        assert_eq!(degrees(Temperature::Snow, area, date(2010, 7, 1), -3.5), -3.5);
    }

    #[test]
    fn without_an_area_only_what_all_share_is_known() {
        assert_eq!(unit_of(Temperature::Air, None, date(2007, 6, 30)), None);
        assert!(unit_of(Temperature::Air, None, date(2007, 7, 1)).is_some());
        assert!(unit_of(Temperature::Snow, None, date(2000, 2, 1)).is_some_and(Unit::is_tenths));
        assert_eq!(unit_of(Temperature::Snow, None, date(2009, 2, 1)), None);
    }

    #[test]
    fn every_day_has_exactly_one_regime_in_every_area() {
        for what in [Temperature::Air, Temperature::Snow] {
            for area in [LOCHABER, None] {
                let mut lines: Vec<_> = REGIMES.iter().filter(|line| line.what == what && line.area == area).collect();
                lines.sort_by_key(|line| line.from);
                assert_eq!((lines[0].from, lines[lines.len() - 1].to), (Date::MIN, Date::MAX));
                for pair in lines.windows(2) {
                    assert_eq!(pair[0].to.tomorrow().unwrap(), pair[1].from);
                }
            }
        }
    }
}
