//! scratch
#![expect(clippy::print_stdout, reason = "reports on the terminal")]
use firn_science::progress::Unobserved;
use firn_science::runout::*;
use firn_science::runout::{
    material::{FlowRule, ShearNorm, Snow},
    release::Slab,
    terrain::Terrain,
};
use std::error::Error;
fn main() -> Result<(), Box<dyn Error>> {
    let a: Vec<String> = std::env::args().collect();
    let snow = match a[1].as_str() {
        "cold_dense" => Snow::li_2020(0.5, 0.0, 1.0, 3e3),
        "warm_shear" => Snow::li_2020(1.5, 0.3, 1.0, 30e3),
        "sliding_slab" => Snow::li_2020(1.5, 0.5, 1.0, 42e3),
        _ => Snow::li_2020(0.5, 1.0, 0.1, 12e3),
    };
    let mesh_m: f64 = a[2].parse()?;
    let end: f64 = a[3].parse()?;
    let limited: f64 = a[4].parse()?;
    let norm = if a.len() > 5 && a[5] == "plane" { ShearNorm::Plane } else { ShearNorm::VonMises };
    let precision = if a.len() > 6 && a[6] == "f64" { Precision::F64 } else { Precision::F32 };
    let terrain = Terrain::slope_arc_flat(40.0, 10.0, -80.0, 260.0)?;
    let angle = 40_f64.to_radians();
    let height = 65.0 * angle.tan() - 9.0 / angle.cos() + 10.0;
    let release = Slab::centred(&terrain, [-65.0, height], 12.0, 2.0);
    let setup = Setup {
        terrain,
        release,
        snow,
        bed_friction: 0.5,
        contact: Contact::Separable,
        flow_rule: FlowRule::Associative,
        shear_norm: norm,
        mesh_m,
        time_step_s: 2.3e-4 * mesh_m / 0.05 * std::env::var("DTF").map_or(1.0, |d| d.parse().unwrap_or(1.0)),
        limited_above: limited,
        precision,
        memory_limit_bytes: 8 << 30,
    };
    let mut s = Simulation::new(&setup)?;
    let e0 = s.energies();
    let mut k = 0;
    let (mut vmax99, mut vcom, mut vmean) = (0.0f64, 0.0f64, 0.0f64);
    let mut last = f64::NAN;
    let mut top = 0.0f64;
    let mut com0 = 0.0;
    while s.time_s() < end {
        k += 1;
        let r = s.step_until(f64::from(k) / 24.0, &Unobserved)?;
        let f = s.snapshot();
        let n = f.x_m.len() as f64;
        let mut x = f.x_m.clone();
        x.sort_by(f32::total_cmp);
        let front = f64::from(x[(0.99 * n) as usize]);
        let com = f.x_m.iter().map(|&x| f64::from(x)).sum::<f64>() / n;
        let v = f.vx_m_s.iter().zip(&f.vz_m_s).map(|(a, b)| f64::from(a.hypot(*b)));
        let vm = v.clone().fold(0.0, f64::max);
        top = top.max(vm);
        let cx = f.vx_m_s.iter().map(|&x| f64::from(x)).sum::<f64>() / n;
        let cz = f.vz_m_s.iter().map(|&x| f64::from(x)).sum::<f64>() / n;
        vcom = vcom.max(cx.hypot(cz));
        vmean = vmean.max(v.clone().sum::<f64>() / n);
        let mut sp: Vec<f64> = v.collect();
        sp.sort_by(f64::total_cmp);
        let v99 = sp[(0.99 * n) as usize];
        vmax99 = vmax99.max(v99);
        last = front; com0 = com;
        if k % 24 == 0 || r != Advance::Reached {
            let e = s.energies();
            let sum = e.kinetic + e.affine + e.potential + e.elastic + e.bed + e.plastic + e.transfer;
            let sum0 = e0.kinetic + e0.affine + e0.potential + e0.elastic;
            let rel = e0.potential - e.potential;
            let broken = f.plastic_strain.iter().filter(|&&p| p > 0.0).count() as f64 / n;
            println!(
                "t {:.2} front {front:.2} com {com:.3} vmax {vm:.2} v99 {v99:.2} vcom {:.2} ke {:.3} aff {:.4} el {:.4} bed {:.3} pl {:.4} tr {:.4} closure {:.5} broken {broken:.2}",
                s.time_s(),
                cx.hypot(cz),
                e.kinetic / rel,
                e.affine / rel,
                e.elastic / rel,
                e.bed / rel,
                e.plastic / rel,
                e.transfer / rel,
                (sum - sum0) / rel
            );
        }
        if r != Advance::Reached {
            println!("{r:?}");
            break;
        }
    }
    println!("END v99max {vmax99:.2} vcom max {vcom:.2} mean {vmean:.2} com {com0:.2} front {last:.2} top {top:.2}");
    Ok(())
}
