//! Renders a bundle's frame to EXR and PNG.
use forelight_scene::Scene;
use forelight_tracer::*;
fn main() {
    let a: Vec<String> = std::env::args().collect();
    let n = |i: usize| a[i].parse::<u32>().unwrap();
    let scene = Scene::load(a[1].as_ref(), &Default::default()).unwrap();
    let t0 = std::time::Instant::now();
    let frame = scene.frame(n(2)).unwrap();
    let s = Settings {
        width: n(3),
        height: n(4),
        spp: n(5),
        ambient_bounces: n(6),
        ambient_divisions: n(7),
        materials: if a[8] == "lambert" { MaterialOverride::Lambert } else { MaterialOverride::Full },
        seed: std::env::var("SEED").map(|s| s.parse().unwrap()).unwrap_or(0),
        ..Settings::default()
    };
    let tracer = Tracer::new(&frame, &s);
    println!("build {:?} {:?} {:?}", t0.elapsed(), tracer.build_cost(), tracer.effects());
    let t0 = std::time::Instant::now();
    let image = tracer.render(None, &|_| {}, &Default::default()).unwrap();
    let t = image.totals();
    println!(
        "render {:?} cpu {:.3} s work/ns {:.3} {:?} Mrays/s/core {:.3}",
        t0.elapsed(),
        t.cpu_nanos as f64 * 1e-9,
        t.work as f64 / t.cpu_nanos as f64,
        t,
        t.rays.iter().sum::<u64>() as f64 / t.cpu_nanos as f64 * 1e3
    );
    image.write_exr((a[9].clone() + ".exr").as_ref(), &frame).unwrap();
    image.picture().save(a[9].clone() + ".png").unwrap();
    image.cost_map().save(a[9].clone() + ".cost.png").unwrap();
}
