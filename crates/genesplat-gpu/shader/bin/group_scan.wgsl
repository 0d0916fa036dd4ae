// Prefix sum over the 256 invocations of a workgroup: sixteen sums of sixteen, then one of those. Few
// barriers. A sum that exceeds 32 bits is the largest number instead, so that it exceeds every capacity, too.

var<workgroup> scan_values: array<u32, 256>;
var<workgroup> scan_rows: array<u32, 17>;

// The sum of `value` over the invocations before `lane`.
fn exclusive_in_group(lane: u32, value: u32) -> u32 {
    scan_values[lane] = value;
    workgroupBarrier();
    if lane < 16u {
        var sum = 0u;
        for (var i = 0u; i < 16u; i++) {
            let at = 16u * lane + i;
            let here = scan_values[at];
            scan_values[at] = sum;
            sum = saturating_add(sum, here);
        }
        scan_rows[lane] = sum;
    }
    workgroupBarrier();
    if lane == 0u {
        var sum = 0u;
        for (var i = 0u; i < 16u; i++) {
            let here = scan_rows[i];
            scan_rows[i] = sum;
            sum = saturating_add(sum, here);
        }
        scan_rows[16] = sum;
    }
    workgroupBarrier();
    return scan_values[lane] + scan_rows[lane / 16u];
}

// The sum over all invocations, after `exclusive_in_group`.
fn group_sum() -> u32 {
    return scan_rows[16];
}
