//! Scratch: methods on sequences, figures on the terminal.
use respire_bench::base::{NoProgress, files};
use respire_bench::reconstruct::*;
use respire_bench::simulate::sequence::Sequence;
use std::path::Path;

fn main() {
    let args: Vec<String> = std::env::args().collect();
    let scale: f64 = args[1].parse().unwrap();
    let methods: Vec<&str> = args[2].split(',').collect();
    for dir in &args[3..] {
        let sequence = match Sequence::open(Path::new(dir)) {
            Ok(s) => s,
            Err(e) => {
                println!("{e}");
                continue;
            }
        };
        let insp = sequence.inspiration().unwrap();
        let exp = sequence.expiration().unwrap();
        for file in &methods {
            let method = respire_bench::reconstruct::method(Path::new(file), scale).unwrap();
            let observation = observe(&sequence, method.access(), 1).unwrap();
            let n = observation.images.len();
            let (mut psnr, mut ahead_psnr, mut rmse, mut delta) = (vec![], vec![], vec![], vec![]);
            let mut phases = vec![];
            let done = method
                .run(
                    &observation,
                    &mut |p: FramePrediction| {
                        let q = |a: &respire_bench::base::Image<f32>| {
                            let b = observation.images[p.frame].to_unit();
                            let m: f64 = a.data.iter().zip(&b.data).map(|(x, y)| ((x - y) as f64).powi(2)).sum::<f64>()
                                / a.data.len() as f64;
                            -10.0 * m.log10()
                        };
                        psnr.push(q(&p.color));
                        if let Some(a) = &p.ahead {
                            ahead_psnr.push(q(a));
                        }
                        let truth = sequence.depth_mm(p.frame).unwrap();
                        let (mut s, mut c, mut good) = (0.0f64, 0, 0);
                        for (d, t) in p.depth_mm.data.iter().zip(&truth.data) {
                            if *t > 0.0 {
                                s += ((d - t) as f64).powi(2);
                                c += 1;
                                if *d > 0.0 && (d / t).max(t / d) < 1.25 {
                                    good += 1
                                }
                            }
                        }
                        if std::env::var("DD").is_ok() && p.frame % 10 == 5 {
                            let mut r: Vec<f32> = p
                                .depth_mm
                                .data
                                .iter()
                                .zip(&truth.data)
                                .filter(|(d, t)| **d > 0.0 && **t > 0.0)
                                .map(|(d, t)| d / t)
                                .collect();
                            r.sort_by(f32::total_cmp);
                            let n = r.len();
                            println!(
                                "frame {} covered {:.3} ratio {:?} t range {:?} {:?}",
                                p.frame,
                                n as f64 / c as f64,
                                [1, 10, 50, 90, 99].map(|q| r[n * q / 100]),
                                truth.data.iter().cloned().fold(9e9, f32::min),
                                truth.data.iter().cloned().fold(0.0, f32::max)
                            );
                        }
                        rmse.push((s / c as f64).sqrt());
                        delta.push(good as f64 / c as f64);
                        phases.extend(p.phase);
                        if std::env::var("DUMP").is_ok() && p.frame % 10 == 5 {
                            let out = format!("/tmp/dump/{}_{:03}", method.id(), p.frame);
                            respire_bench::formats::png::write_rgb(
                                Path::new(&format!("{out}.png")),
                                &respire_bench::base::image::codes_from_unit(&p.color),
                            )
                            .unwrap();
                        }
                        Ok(())
                    },
                    &NoProgress,
                )
                .unwrap();
            let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len().max(1) as f64;
            let last = sequence.frames.last().unwrap();
            let truth_mesh = respire_bench::base::mesh::interpolate(&insp.vertices, &exp.vertices, last.phase);
            let eye = last.world_from_camera.translation;
            let target = done.final_mesh.map(|m| {
                let mut s = (0.0, 0);
                for (a, b) in m.vertices.iter().zip(&truth_mesh) {
                    if b.distance(eye) < 15.0 {
                        s.0 += a.distance(*b);
                        s.1 += 1;
                    }
                }
                s.0 / s.1.max(1) as f64
            });
            print!(
                "{:>10} {:18} f{} {:6.3} s/f psnr {:5.2} ahead {:5.2} rmse {:6.2} d {:.3}",
                sequence.case_id,
                method.id(),
                insp.faces.len(),
                done.seconds / n as f64,
                mean(&psnr),
                mean(&ahead_psnr),
                mean(&rmse),
                mean(&delta)
            );
            if let Some(t) = target {
                print!(" near15 {t:.2}");
            }
            if phases.len() == n {
                let t: Vec<f64> = sequence.frames.iter().map(|f| f.phase).collect();
                let e: Vec<f64> = phases.iter().zip(&t).map(|(a, b)| a - b).collect();
                let (ma, mb) = (mean(&phases), mean(&t));
                let (mut ab, mut aa, mut bb) = (0.0, 0.0, 0.0);
                for (a, b) in phases.iter().zip(&t) {
                    ab += (a - ma) * (b - mb);
                    aa += (a - ma) * (a - ma);
                    bb += (b - mb) * (b - mb);
                }
                print!(
                    " mae {:.4} bias {:+.4} r {:.4} last {:+.3}",
                    mean(&e.iter().map(|v| v.abs()).collect::<Vec<_>>()),
                    mean(&e),
                    ab / (aa * bb as f64).sqrt(),
                    e[n - 1]
                );
                if std::env::var("PH").is_ok() {
                    print!(
                        "\n   e {:?}\n   t {:?}",
                        e.iter().map(|v| (v * 1000.0).round() as i32).collect::<Vec<_>>(),
                        t.iter().map(|v| (v * 1000.0).round() as i32).collect::<Vec<_>>()
                    );
                }
            }
            println!();
        }
    }
    let _ = files::read_bytes(Path::new("/dev/null"));
}
