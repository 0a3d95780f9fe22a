//! One function per stage: from the inputs of a case to its outputs.

use crate::Error;
use crate::case::{Answer, Case};
use crate::gpu::Gpu;
use crate::render::{self, Map, View, columns_of};
use crate::{adam, field, losses, train};

type Stage = fn(&Gpu, &Case) -> Result<Answer, Error>;

const STAGES: [(&str, Stage); 8] = [
    ("sh", harmonics),
    ("projection_covariance", projection),
    ("raster", raster),
    ("raster_backward", raster_backward),
    ("losses", losses::stage),
    ("adam", adam::stage),
    ("train_step", train::stage),
    ("mean_field", field::stage),
];

/// What answers the case; `None` for a stage that is not ported.
pub fn of(case: &Case) -> Option<Stage> {
    let found = STAGES.iter().find(|(name, _)| *name == case.stage);
    found.map(|(_, stage)| *stage)
}

fn harmonics(gpu: &Gpu, case: &Case) -> Result<Answer, Error> {
    let n = case.array("direction")?.shape[0];
    let directions = gpu.upload(&case.singles("direction")?);
    let coefficients = gpu.upload(&case.singles("sh")?);
    let [basis, gradient, colors] = [16 * n, 48 * n, 12 * n].map(|words| gpu.zeros(words));
    gpu.run_over(
        "harmonics/stage",
        &[&directions, &coefficients, &basis, &gradient, &colors],
        n,
    );
    let mut out = Answer::default();
    out.put("basis", &[n, 16], gpu.read::<f32>(&basis, 16 * n)?);
    out.put(
        "tangent_gradient",
        &[n, 16, 3],
        gpu.read::<f32>(&gradient, 48 * n)?,
    );
    out.put("color", &[n, 4, 3], gpu.read::<f32>(&colors, 12 * n)?);
    Ok(out)
}

/// The splats in the order of `who`, column by column.
fn put_splats(out: &mut Answer, splats: &[f32], who: &[u32]) {
    let n = who.len();
    let of = |columns: &[usize]| -> Vec<f32> {
        let row = |&i: &u32| columns.iter().map(move |c| splats[16 * i as usize + c]);
        who.iter().flat_map(row).collect()
    };
    out.put("mean_px", &[n, 2], of(&[0, 1]));
    out.put("depth_m", &[n], of(&[6]));
    out.put("conic", &[n, 3], of(&[2, 11, 7]));
    out.put("splat_color", &[n, 3], of(&[8, 9, 10]));
}

fn projection(gpu: &Gpu, case: &Case) -> Result<Answer, Error> {
    let map = Map::of_case(case)?;
    let n = map.gaussians;
    let view = View::of_case(gpu, case, &map, "")?;
    let rows = gpu.upload(&map.rows);
    let splats = render::project(gpu, &view, &rows, &gpu.zeros(n), n);
    let [p_cam, rotation] = render::describe(gpu, &view, &rows, n);
    let radii = gpu.read::<i32>(&splats.radii, n)?;
    let who: Vec<u32> = (0..n as u32).filter(|&i| radii[i as usize] > 0).collect();
    let cells = gpu.read::<u32>(&splats.splats, 16 * n)?;
    // Cells to pixels, the last one cut at the border.
    let size = [view.width, view.height, view.width, view.height];
    let edge = |i: u32, k: usize| (16 * cells[16 * i as usize + 12 + k]).min(size[k] as u32) as i32;
    let footprint: Vec<i32> = who
        .iter()
        .flat_map(|&i| [0, 1, 2, 3].map(|k| edge(i, k)))
        .collect();
    let mut out = Answer::default();
    out.put("p_cam", &[n, 3], gpu.read::<f32>(&p_cam, 3 * n)?);
    out.put("rotation", &[n, 3, 3], gpu.read::<f32>(&rotation, 9 * n)?);
    put_splats(&mut out, &gpu.read::<f32>(&splats.splats, 16 * n)?, &who);
    let radius: Vec<i32> = radii.into_iter().filter(|&r| r > 0).collect();
    out.put("radius", &[radius.len()], radius);
    out.put("footprint", &[who.len(), 4], footprint);
    Ok(out)
}

fn raster(gpu: &Gpu, case: &Case) -> Result<Answer, Error> {
    let map = Map::of_case(case)?;
    let n = map.gaussians;
    let view = View::of_case(gpu, case, &map, "")?;
    let splats = render::project(gpu, &view, &gpu.upload(&map.rows), &gpu.zeros(n), n);
    let rendered = render::blend(gpu, &view, &splats)?;
    let radii = gpu.read::<i32>(&splats.radii, n)?;
    let visible = radii.iter().filter(|&&r| r > 0).count();
    let order = gpu.read::<u32>(&rendered.order, visible)?;
    let image = gpu.read::<f32>(&rendered.image, 8 * view.pixels())?;
    let shape = [view.height, view.width];
    let whole = |c| -> Vec<i32> {
        columns_of(&image, 8, c, 1)
            .iter()
            .map(|&v| v as i32)
            .collect()
    };
    let mut out = Answer::default();
    out.put(
        "color",
        &[view.height, view.width, 3],
        columns_of(&image, 8, 0, 3),
    );
    out.put("depth", &shape, columns_of(&image, 8, 4, 1));
    out.put("transmittance", &shape, columns_of(&image, 8, 3, 1));
    out.put("contributors", &shape, whole(5));
    out.put("last", &shape, whole(6));
    out.put("radii", &[n], radii);
    put_splats(&mut out, &gpu.read::<f32>(&splats.splats, 16 * n)?, &order);
    out.put(
        "order",
        &[visible],
        order.iter().map(|&i| i as i32).collect::<Vec<_>>(),
    );
    Ok(out)
}

fn raster_backward(gpu: &Gpu, case: &Case) -> Result<Answer, Error> {
    let map = Map::of_case(case)?;
    let n = map.gaussians;
    let view = View::of_case(gpu, case, &map, "")?;
    let rows = gpu.upload(&map.rows);
    let splats = render::project(gpu, &view, &rows, &gpu.zeros(n), n);
    let rendered = render::blend(gpu, &view, &splats)?;
    let color = case.singles("upstream_color")?;
    let depth = case.singles("upstream_depth")?;
    let opacity = case.singles("upstream_opacity")?;
    let pixel = |i: usize| {
        [
            color[3 * i],
            color[3 * i + 1],
            color[3 * i + 2],
            depth[i],
            opacity[i],
        ]
    };
    let upstream: Vec<f32> = (0..view.pixels()).flat_map(pixel).collect();
    let found = render::backward(
        gpu,
        &view,
        &rows,
        &splats,
        &rendered,
        &gpu.upload(&upstream),
    );
    let mut out = Answer::default();
    put_map(
        &mut out,
        &map,
        &gpu.read::<f32>(&found.map, map.rows.len())?,
        "d_",
        "",
    );
    let by_splat = gpu.read::<f32>(&found.splats, 10 * n)?;
    for (name, first, count) in [("means2d", 0, 2), ("conics", 2, 3), ("colors", 6, 3)] {
        out.put(
            format!("d_{name}"),
            &[n, count],
            columns_of(&by_splat, 10, first, count),
        );
    }
    for (name, column) in [("opacities", 5), ("depths", 9)] {
        out.put(
            format!("d_{name}"),
            &[n],
            columns_of(&by_splat, 10, column, 1),
        );
    }
    out.put("d_pose", &[6], gpu.read::<f32>(&found.pose, 6)?);
    Ok(out)
}

/// Parameters of a map, or what has its shape, each as an output.
pub fn put_map(out: &mut Answer, map: &Map, rows: &[f32], before: &str, after: &str) {
    for (name, first, count) in map.groups() {
        let values = columns_of(rows, map.columns(), first, count);
        out.put(format!("{before}{name}{after}"), &map.shape(name), values);
    }
}
